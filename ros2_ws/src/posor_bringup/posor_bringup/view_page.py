"""The live page: a web page on this host with the arm in 3-D, the health of its joints and strip charts."""

from __future__ import annotations

import os
import socket
import time
from collections import deque
from datetime import UTC, datetime
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import viser
from posor.errors import ParameterError
from posor.numerics.stamps import NS

from posor_bringup.view_geometry import ellipsoid, enlarge
from posor_bringup.view_observation import NO_MESSAGE, NO_STATE, SILENT

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from posor.numerics.array_types import FloatArray

    from posor_bringup.view_geometry import ArmGeometry, DrawnArm
    from posor_bringup.view_observation import EndpointView, Health, Observation

HOST = "127.0.0.1"
CHART_PERIOD_S, TEXT_PERIOD_S = 0.25, 0.2
"""Time between two updates of the charts and of the numbers; a change of state is shown at once."""
CHART_S = 30.0  # time that a chart shows
MAX_POWER, USUAL_POWER = 4.0, 2.0  # of ten, of the enlargement
PANEL_WIDTH = 520
GREY, RED, AMBER, GREEN, BLUE = (150, 150, 150), (218, 54, 51), (227, 150, 20), (46, 150, 67), (70, 120, 220)
COLOURS = {
    "OK": GREEN,
    "DEGRADED": AMBER,
    "UNCOUNTED": AMBER,
    NO_STATE: AMBER,
    NO_MESSAGE: GREY,
    "LOST": RED,
    "STALE": RED,
    SILENT: RED,
}
STROKES = ("#d62728", "#2ca02c", "#1f77b4", "#ff7f0e", "#9467bd", "#8c564b", "#17becf", "#7f7f7f")
DOTS = {"width": 0, "points": {"show": True, "size": 3}}
"""Charts have no lines, which would bridge the times without data."""
AXES = ("x", "y", "z", "about X", "about Y", "about Z")


class _DrawnLinks:
    """The links of one arm in the scene; links that move with a joint or a beam are drawn in its frame."""

    def __init__(self, scene: Any, root: str, geometry: ArmGeometry, colour: tuple[int, int, int] | None) -> None:
        """Draw the arm at zero; ``colour`` of a translucent arm, None: in the colours of its URDF."""
        self._joints = dict(zip(geometry.joints, geometry.ends, strict=False))
        transforms = [each.T_parent_child for each in geometry.fixed] + geometry.at_zero
        links = [each.child for each in geometry.fixed] + [child for _, child in geometry.ends]
        scene.add_frame(f"{root}/{geometry.base}", show_axes=False)
        frames = {
            link: scene.add_frame(f"{root}/{geometry.path(link)}", show_axes=False)
            for link in sorted(links, key=geometry.path)
        }
        for link, transform in zip(links, transforms, strict=True):
            _place(frames[link], transform)
        self._transforms: Sequence[pin.SE3] = geometry.at_zero
        self._moving = [frames[child] for _, child in geometry.ends]
        self._bodies: list[tuple[str, Any, tuple[int, ...]]] = []
        for number, body in enumerate(geometry.bodies):
            rgb = colour or tuple(round(255 * part) for part in body.colour)
            look = {
                "color": rgb,
                "opacity": None if colour is None else 0.3,
                "cast_shadow": False,
                "receive_shadow": False,
            }
            name = f"{root}/{geometry.path(body.link)}/body{number}"
            handle: Any
            if body.shape == "cylinder":
                handle = scene.add_cylinder(name, *body.size, **look)
            elif body.shape == "box":
                handle = scene.add_box(name, dimensions=body.size, **look)
            else:
                handle = scene.add_icosphere(name, *body.size, **look)
            _place(handle, body.T_link_body)
            self._bodies.append((body.link, handle, rgb))
        self._shown: dict[str, tuple[int, ...]] = {}

    def move(self, transforms: Sequence[pin.SE3]) -> None:
        """Move the links of joints and beams that are elsewhere than before."""
        for frame, old, new in zip(self._moving, self._transforms, transforms, strict=True):
            if not np.array_equal(old.homogeneous, new.homogeneous):
                _place(frame, new)
        self._transforms = transforms

    def paint(self, colours: dict[str, tuple[int, int, int] | None], others: tuple[int, int, int] | None) -> None:
        """Paint the links on both sides of some joints, and all others; None: in their own colours."""
        links = {link: colour for name, colour in colours.items() if colour for link in self._joints[name]}
        for link, handle, own in self._bodies:
            rgb = links.get(link) or others or own
            if self._shown.get(handle.name) != rgb:
                handle.color = self._shown[handle.name] = rgb


def _place(handle: Any, transform: pin.SE3) -> None:
    x, y, z, w = pin.Quaternion(transform.rotation).coeffs()
    handle.position, handle.wxyz = transform.translation, (w, x, y, z)


class _Chart:
    """A strip chart; its points are sent to the page a few times a second."""

    def __init__(self, server: viser.ViserServer, title: str, names: Sequence[str]) -> None:
        self._points: deque[tuple[float, ...]] = deque()
        series: list[Any] = [{"label": "time"}]
        series += [{"label": name, "stroke": STROKES[n % len(STROKES)], **DOTS} for n, name in enumerate(names)]
        empty = tuple(np.zeros(1) for _ in series)
        self._plot = server.gui.add_uplot(empty, tuple(series), title=title, height=190)

    def add(self, time_s: float, values: Iterable[float]) -> None:
        """Add a point unless a value is missing; a chart whose time goes back begins anew."""
        point = (time_s, *values)
        if self._points and time_s < self._points[-1][0]:
            self._points.clear()
        if np.isfinite(point).all() and not (self._points and time_s == self._points[-1][0]):
            self._points.append(point)
        while self._points and self._points[0][0] < time_s - CHART_S:
            self._points.popleft()

    def send(self) -> None:
        """Show the points."""
        if self._points:
            self._plot.data = tuple(np.array(self._points).T)


class _LocalServer(viser.ViserServer):
    """A web server of this host."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002, FBT001, FBT002
        """Refuse to publish the page through a server of others, which any page could ask for otherwise."""
        return None


def _check_port(port: int) -> None:
    """Refuse a port that another program uses; viser would take the next one.

    Raises ParameterError: the port cannot be used.
    """
    try:
        socket.create_server((HOST, port)).close()
    except OSError as error:
        raise ParameterError(
            f"port {port} cannot be used: {os.strerror(error.errno or 0).lower()}",
            where="option --port",
            expected="a free port, or 0; perhaps another 'view' uses it",
        ) from error


class ViewPage:
    """The page and its web server."""

    def __init__(self, name: str, geometry: ArmGeometry, port: int, duration_s: float | None) -> None:
        """Serve the page on a port of this host, 0: any free one.

        ``duration_s`` is the length of the replayed bag [s]; None: the arm is running. Raises ParameterError: the
        port cannot be used.
        """
        self._name, self._geometry = name, geometry
        _check_port(port)
        self._server = _LocalServer(host=HOST, port=port, label=name, verbose=False)
        self._add_scene()
        self._add_panel(duration_s)
        self._position_s = 0.0
        self._drawn_health: object = None
        self._next_text_s = self._next_chart_s = 0.0

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{HOST}:{self._server.get_port()}"

    @property
    def has_clients(self) -> bool:
        """Whether a browser shows the page."""
        return bool(self._server.get_clients())

    @property
    def is_frozen(self) -> bool:
        """Whether the page shall not follow the arm."""
        return self._freeze is not None and bool(self._freeze.value)

    def close(self) -> None:
        """End the web server."""
        self._server.stop()

    def _add_scene(self) -> None:
        server, geometry = self._server, self._geometry
        scene = server.scene
        scene.set_up_direction("+z")
        scene.configure_default_lights(cast_shadow=False)
        scene.configure_environment_map(None)  # three times as many pictures a second without a graphics card
        scene.add_light_ambient("/ambient", intensity=1.5)
        reach = max(0.5, float(np.linalg.norm(geometry.place(geometry.endpoint, geometry.at_zero).translation)))
        server.initial_camera.position = (0.6 * reach, -1.0 * reach, 0.7 * reach)
        server.initial_camera.look_at = (0.45 * reach, 0.15 * reach, 0.0)
        scene.add_grid(
            "/grid", 4.0 * reach, 4.0 * reach, cell_size=0.1, section_size=0.5, position=(0.0, 0.0, -0.5 * reach)
        )
        self._measured = _DrawnLinks(scene, "/measured", geometry, None)
        self._encoders = _DrawnLinks(scene, "/encoders", geometry, BLUE)
        self._endpoint = scene.add_frame("/endpoint", axes_length=0.1 * reach, axes_radius=0.002 * reach, visible=False)
        self._ellipsoid = scene.add_icosphere("/endpoint_2_sigma", 1.0, GREEN, opacity=0.5, visible=False)
        self._protection = scene.add_box("/protection_level", AMBER, wireframe=True, visible=False)

    def _add_panel(self, duration_s: float | None) -> None:
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        self._banner = gui.add_html("")
        self._freeze: Any = None
        self._play: Any = None
        self._slider: Any = None
        if duration_s is None:
            self._freeze = gui.add_checkbox("freeze", initial_value=False, hint="stop the page; the arm goes on")
        else:
            self._play = gui.add_checkbox("play", initial_value=True)
            self._slider = gui.add_slider("position [s]", 0.0, max(duration_s, 0.01), 0.01, 0.0)
        marks = tuple((float(power), f"{10**power}") for power in range(int(MAX_POWER) + 1))
        self._power = gui.add_slider("deviation enlarged, 10^n", 0.0, MAX_POWER, 0.25, USUAL_POWER, marks=marks)
        self._table = gui.add_html("")
        joints = self._geometry.joints
        self._charts = (
            _Chart(self._server, "deviation of the endpoint from nominal [um]", AXES[:3]),
            _Chart(self._server, "residual: chi-square / redundancy [-]", joints),
            _Chart(self._server, "latency from the stamp [ms]", ("publication", "reception")),
        )

    def replay_position(self, period_s: float) -> float:
        """Return the position of the slider in the bag [s], advanced by a period while the bag plays."""
        slider, play = self._slider, self._play
        if play.value:
            # A slider that was moved by hand differs from the position before.
            start_s = self._position_s if abs(slider.value - self._position_s) <= slider.step else slider.value
            self._position_s = min(start_s + period_s, slider.max)
            slider.value = round(self._position_s, 2)
            play.value = self._position_s < slider.max
        else:
            self._position_s = slider.value
        return self._position_s

    def show_frozen(self) -> None:
        """Say that the page does not follow the arm."""
        if self._drawn_health != "frozen":
            self._drawn_health = "frozen"
            now = datetime.now(UTC).strftime("%H:%M:%S")
            self._banner.content = _banner(self._name, "FROZEN", GREY, (f"the page is as it was at {now} UTC",))

    def update(self, observation: Observation, drawn: DrawnArm | None) -> None:
        """Draw an observation; ``drawn`` is the arm of its scan."""
        now_s, factor = time.monotonic(), 10.0**self._power.value
        health = observation.overall, observation.joints
        has_changed = health != self._drawn_health
        with self._server.atomic():
            self._draw_scene(observation, drawn, factor)
            if has_changed or now_s >= self._next_text_s:
                self._next_text_s, self._drawn_health = now_s + TEXT_PERIOD_S, health
                self._write_texts(observation, drawn)
            if observation.is_fresh and observation.endpoint is not None:
                self._add_points(observation, observation.endpoint, drawn)
            if now_s >= self._next_chart_s:
                self._next_chart_s = now_s + CHART_PERIOD_S
                for chart in self._charts:
                    chart.send()

    def _draw_scene(self, observation: Observation, drawn: DrawnArm | None, factor: float) -> None:
        is_known = drawn is not None and drawn.measured is not None
        if drawn is not None:
            self._encoders.move(drawn.nominal)
        colours = {name: _colour(health, observation) for name, health in observation.joints.items()}
        colours_of_faults = {name: None if colour == GREEN else colour for name, colour in colours.items()}
        self._measured.paint(colours_of_faults, None if is_known else GREY)
        self._encoders.paint({}, BLUE if drawn is not None else GREY)
        endpoint = observation.endpoint
        covariance = np.full((3, 3), np.nan) if endpoint is None else endpoint.covariance[:3, :3]
        level = np.full(3, np.nan) if endpoint is None else endpoint.protection_level[:3]
        pose = np.full(7, np.nan) if endpoint is None else endpoint.pose
        is_here = observation.is_fresh and endpoint is not None and endpoint.frame == self._geometry.base
        self._endpoint.visible = is_here and bool(np.isfinite(pose).all())
        self._ellipsoid.visible = self._endpoint.visible and bool(np.isfinite(covariance).all())
        self._protection.visible = self._endpoint.visible and bool(np.isfinite(level).all())
        T_base_endpoint = pin.SE3.Identity()
        if drawn is not None and drawn.measured is not None:
            enlarged = enlarge(drawn.nominal, drawn.measured, factor)
            self._measured.move(enlarged)
            T_base_endpoint = self._geometry.place(self._geometry.endpoint, enlarged)
        elif self._endpoint.visible:
            T_base_endpoint = pin.XYZQUATToSE3(pose)
        _place(self._endpoint, T_base_endpoint)
        if self._ellipsoid.visible:
            half_axes, axes = ellipsoid(covariance)
            self._ellipsoid.scale = tuple(factor * half_axes)
            _place(self._ellipsoid, pin.SE3(axes, T_base_endpoint.translation))
        if self._protection.visible:
            self._protection.scale = tuple(2.0 * factor * level)
            self._protection.position = T_base_endpoint.translation

    def _write_texts(self, observation: Observation, drawn: DrawnArm | None) -> None:
        health, endpoint = observation.overall, observation.endpoint
        sentences = health.sentences
        if endpoint is not None and endpoint.stamp_ns:
            stamp = datetime.fromtimestamp(endpoint.stamp_ns / NS, UTC).strftime("%Y-%m-%d %H:%M:%S.%f")[:-3]
            sentences = (f"{'scan' if observation.is_fresh else 'last scan'} of {stamp} UTC", *sentences)
        self._banner.content = _banner(self._name, health.state, _colour(health, observation), sentences)
        rows = "".join(_health_row(name, each, _colour(each, observation)) for name, each in observation.joints.items())
        numbers = _numbers(endpoint if observation.is_fresh else None, drawn)
        self._table.content = (
            f'<table id="joints" style="width:100%;font-size:12px">{rows}</table>'
            f'<table id="endpoint" style="width:97%;font-size:13px;text-align:right">{numbers}</table>'
        )

    def _add_points(self, observation: Observation, endpoint: EndpointView, drawn: DrawnArm | None) -> None:
        deviation, residuals, latency = self._charts
        if observation.scan is not None and drawn is not None:
            time_s = observation.scan.stamp_ns / NS
            deviation.add(time_s, 1e6 * drawn.deviation[:3])
            residuals.add(time_s, observation.scan.residuals)
        latency.add(endpoint.stamp_ns / NS, (1e3 * endpoint.age_s, 1e3 * endpoint.latency_s))


def _colour(health: Health, observation: Observation) -> tuple[int, int, int]:
    return COLOURS.get(health.state, RED) if observation.is_fresh else GREY


def _banner(name: str, state: str, colour: tuple[int, int, int], sentences: Iterable[str]) -> str:
    text = "<br>".join(escape(sentence) for sentence in sentences)
    style = f"background:rgb{colour};color:white;padding:6px 10px;border-radius:4px"
    return f'<div id="banner" style="{style}"><b>{escape(name)}: {state}</b><br>{text}</div>'


def _health_row(name: str, health: Health, colour: tuple[int, int, int]) -> str:
    sentences = "<br>".join(escape(sentence) for sentence in health.sentences)
    state = f'<td style="color:rgb{colour};white-space:nowrap"><b>{health.state}</b></td>'
    cells = f'<td style="white-space:nowrap">{name}</td>{state}<td style="width:100%">{sentences}</td>'
    return f'<tr id="joint-{name}" style="border-bottom:1px solid #ddd">{cells}</tr>'


def _numbers(endpoint: EndpointView | None, drawn: DrawnArm | None) -> str:
    columns, causes = np.full((4, 6), np.nan), [""] * 6
    if drawn is not None:
        columns[1] = 1e6 * drawn.deviation
    if endpoint is not None:
        if np.isfinite(endpoint.pose).all():
            pose = pin.XYZQUATToSE3(endpoint.pose)
            columns[0] = *(1e3 * pose.translation), *(1e3 * pin.log3(pose.rotation))
        columns[2] = 2e6 * np.sqrt(np.diag(endpoint.covariance))
        columns[3] = 1e6 * endpoint.protection_level
        causes[: len(endpoint.protection_causes)] = endpoint.protection_causes
    names = ("endpoint", "pose", "from nominal", "2 sigma", "protection", "set by")
    head = f"<tr>{''.join(f'<th>{name}</th>' for name in names)}</tr>"
    rows = [head]
    for number, axis in enumerate(AXES):
        unit = ("mm", "um") if number < 3 else ("mrad", "urad")  # noqa: PLR2004  translation, then rotation
        cells = [_cell(columns[0, number], 4, unit[0]), *(_cell(value, 2, unit[1]) for value in columns[1:, number])]
        numbers = "".join(f'<td style="white-space:nowrap">{cell}</td>' for cell in (axis, *cells))
        rows.append(f"<tr>{numbers}<td><small>{escape(causes[number])}</small></td></tr>")
    return "".join(rows)


def _cell(value: FloatArray | float, digits: int, unit: str) -> str:
    return f"{value:.{digits}f} {unit}" if np.isfinite(value) else "not bounded" if np.isinf(value) else "-"
