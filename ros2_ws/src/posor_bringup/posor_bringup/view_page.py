# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
"""The live page: a web page on this host with the statement on the endpoint, the arm in 3-D, charts and events."""

from __future__ import annotations

import logging
import os
import socket
import time
from datetime import UTC, datetime
from threading import Event as Wake
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
import viser
from posor.errors import ParameterError
from posor.numerics.stamps import NS

from posor_bringup.view_charts import Axis, draw_charts
from posor_bringup.view_geometry import ellipsoid, enlarge
from posor_bringup.view_record import STATE_COLOURS, WINDOWS_S
from posor_bringup.view_texts import (
    BLUE,
    GREEN,
    GREY,
    banner,
    causes_table,
    colour_of,
    events_table,
    joints_table,
    no_update_notice,
    numbers_table,
    statement,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from posor_bringup.view_geometry import ArmGeometry, DrawnArm
    from posor_bringup.view_observation import Observation
    from posor_bringup.view_record import ArmRecord

HOST = "127.0.0.1"
HANDLER_FAILED = "connection handler failed"  # record of websockets, where viser cannot read a message
NO_REQUEST = "InvalidMessage"  # error of websockets, on a connection that sends no HTTP request
CHART_PERIOD_S, TEXT_PERIOD_S = 0.5, 0.2
"""Time between two updates of the charts and of the numbers; a change of state is shown at once."""
MAX_POWER, USUAL_POWER = 4.0, 2.0  # of ten, of the enlargement
PANEL_WIDTH = 560
GHOST, SHADE = 0.3, 0.3  # opacity of links of unknown pose, and of the nominal arm
ORANGE = (227, 150, 20)


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
        self._opacity = None if colour is None else SHADE
        self._moving = [frames[child] for _, child in geometry.ends]
        self._bodies: list[tuple[str, Any, tuple[int, ...]]] = []
        for number, body in enumerate(geometry.bodies):
            rgb = colour or tuple(round(255 * part) for part in body.colour)
            look = {
                "color": rgb,
                "opacity": None if colour is None else SHADE,
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
        self._shown: dict[str, tuple[tuple[int, ...], float | None]] = {}

    def move(self, transforms: Sequence[pin.SE3]) -> None:
        """Move the links of joints and beams that are elsewhere than before."""
        for frame, old, new in zip(self._moving, self._transforms, transforms, strict=True):
            if not np.array_equal(old.homogeneous, new.homogeneous):
                _place(frame, new)
        self._transforms = transforms

    def paint(
        self,
        colours: dict[str, tuple[int, int, int] | None],
        others: tuple[int, int, int] | None,
        ghosts: Collection[str],
    ) -> None:
        """Paint the links on both sides of some joints, and all others; None: in their own colours.

        ``ghosts``: links of unknown pose.
        """
        links = {link: colour for name, colour in colours.items() if colour for link in self._joints[name]}
        for link, handle, own in self._bodies:
            is_ghost = link in ghosts
            look = links.get(link) or (GREY if is_ghost else others or own), GHOST if is_ghost else self._opacity
            if self._shown.get(handle.name) != look:
                self._shown[handle.name] = look
                handle.color, handle.opacity = look

    def show(self, links: Collection[str]) -> None:
        """Show the bodies of some links only."""
        for link, handle, _ in self._bodies:
            if handle.visible != (link in links):
                handle.visible = link in links


def _place(handle: Any, transform: pin.SE3) -> None:
    x, y, z, w = pin.Quaternion(transform.rotation).coeffs()
    handle.position, handle.wxyz = transform.translation, (w, x, y, z)


class _LocalServer(viser.ViserServer):
    """A web server of this host."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002, FBT001, FBT002
        """Refuse to publish the page through a server of others, which any page could ask for otherwise."""
        return None


def _report_connection(record: logging.LogRecord) -> bool:
    """Let a record be printed: one sentence about an unreadable message, nothing of a connection without a request."""
    error = type(record.exc_info[1]).__name__ if record.exc_info else ""
    if record.msg == HANDLER_FAILED:
        record.msg, record.exc_info = f"view: a client sent no message of the page, and is disconnected: {error}", None
    return error != NO_REQUEST


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

    def __init__(
        self, name: str, geometry: ArmGeometry, port: int, record: ArmRecord, span_ns: tuple[int, int] | None = None
    ) -> None:
        """Serve the page on a port of this host, 0: any free one.

        ``record``: what the page shows of the past; ``span_ns``: first and last time of a replayed bag [ns]; None: the
        arm is running. Raises ParameterError: the port cannot be used.
        """
        self._name, self._geometry, self._record, self._span_ns = name, geometry, record, span_ns
        _check_port(port)
        logging.getLogger("websockets.server").addFilter(_report_connection)
        self._server = _LocalServer(host=HOST, port=port, label=name, verbose=False)
        self._wake = Wake()
        self._server.on_client_connect(lambda _client: self._wake.set())
        self._add_scene()
        self._add_panel()
        self._position_s = 0.0
        self._drawn_health: object = None
        self._next_text_s = self._next_chart_s = 0.0
        self._now_ns = 0

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

    def wait(self, seconds: float) -> None:
        """Wait for some time, or until a browser opens the page [s]."""
        self._wake.wait(max(0.0, seconds))
        self._wake.clear()

    def rest(self) -> None:
        """Leave nothing on a page without a browser that could look fresh to the next one."""
        if self._drawn_health != "at rest":
            self._drawn_health, self._next_chart_s = "at rest", 0.0
            with self._server.atomic():
                self._banner.content = banner(self._name, "CONNECTING", GREY, "", ("the page is being drawn",))
                for each in (self._causes, self._numbers, self._events, self._charts):
                    each.content = ""
                self._measured.paint({}, GREY, self._geometry.links)
                self._encoders.show(())

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
        self._protection = scene.add_box("/protection_level", ORANGE, wireframe=True, visible=False)

    def _add_panel(self) -> None:
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        self._banner, self._causes = gui.add_html(""), gui.add_html("")
        self._freeze: Any = None
        self._play: Any = None
        self._slider: Any = None
        self._window: Any = None
        if self._span_ns is None:
            self._freeze = gui.add_checkbox("freeze", initial_value=False, hint="stop the page; the arm goes on")
            self._window = gui.add_dropdown("time shown", tuple(WINDOWS_S))
        else:
            duration_s = (self._span_ns[1] - self._span_ns[0]) / NS
            self._play = gui.add_checkbox("play", initial_value=True)
            self._slider = gui.add_slider("position [s]", 0.0, max(duration_s, 0.01), 0.01, 0.0)
        self._charts, self._events = gui.add_html(""), gui.add_html("")
        button = gui.add_button("download the events (CSV)")
        button.on_click(lambda event: self._send_events(event.client))
        self._numbers = gui.add_html("")
        marks = tuple((float(power), f"{10**power}") for power in range(int(MAX_POWER) + 1))
        self._power = gui.add_slider("deviation enlarged, 10^n", 0.0, MAX_POWER, 0.25, USUAL_POWER, marks=marks)

    def _send_events(self, client: viser.ClientHandle | None) -> None:
        if client is not None:
            client.send_file_download(
                f"{self._name}_events.csv", self._record.log.to_csv(self._now_ns), save_immediately=True
            )

    def replay_position(self, period_s: float) -> float:
        """Return the position of the slider in the bag [s], advanced by a period while the bag plays."""
        slider, play = self._slider, self._play
        if play.value:
            # A slider that was moved by hand differs from the position before.
            start_s = self._position_s if abs(slider.value - self._position_s) <= slider.step else slider.value
            self._position_s = min(start_s + period_s, slider.max)
            slider.value = round(self._position_s, 2)
            if self._position_s >= slider.max:  # a play that is set to true would undo a click
                play.value = False
        else:
            self._position_s = slider.value
        return self._position_s

    def show_frozen(self) -> None:
        """Say that the page does not follow the arm."""
        if self._drawn_health != "frozen":
            self._drawn_health = "frozen"
            now = datetime.now(UTC).strftime("%H:%M:%S")
            self._banner.content = banner(self._name, "FROZEN", GREY, "", (f"the page is as it was at {now} UTC",))

    def update(self, observation: Observation, drawn: DrawnArm | None) -> None:
        """Draw an observation; ``drawn`` is the arm of its scan."""
        now_s, factor = time.monotonic(), 10.0**self._power.value
        self._now_ns = observation.time_ns if self._span_ns is None else self._span_ns[1]
        health = observation.state, observation.joints, tuple(cause.key for cause in observation.causes)
        has_changed = health != self._drawn_health
        with self._server.atomic():
            self._draw_scene(observation, drawn, factor)
            if has_changed or now_s >= self._next_text_s:
                self._next_text_s, self._drawn_health = now_s + TEXT_PERIOD_S, health
                notice = no_update_notice(time.time_ns()) if self._span_ns is None else ""
                self._banner.content = statement(self._name, observation, self._record) + notice
                self._causes.content = joints_table(observation) + causes_table(observation, self._record.log)
                self._numbers.content = numbers_table(observation, drawn)
            if has_changed or now_s >= self._next_chart_s:
                self._next_chart_s = now_s + CHART_PERIOD_S
                self._events.content = events_table(self._record.log, observation.time_ns)
                self._charts.content = self._draw_charts(observation)

    def _draw_charts(self, observation: Observation) -> str:
        record, now_s = self._record, observation.time_ns / NS
        window = 0
        if self._span_ns is not None:
            begin_s, end_s = (time_ns / NS for time_ns in self._span_ns)
            axis = Axis(begin_s, max(end_s, begin_s + 1.0), now_s)
        else:
            window = tuple(WINDOWS_S).index(self._window.value)
            axis = Axis(now_s - record.history.windows_s[window], now_s)
        run, points = record.history.run, record.history.points(window)
        return draw_charts(points, axis, record.charts, record.state_column, STATE_COLOURS, run)

    def _draw_scene(self, observation: Observation, drawn: DrawnArm | None, factor: float) -> None:
        if drawn is not None:
            self._encoders.move(drawn.nominal)
        colours = {name: colour_of(state) for name, state in observation.joints.items()}
        colours_of_faults = {name: None if colour == GREEN else colour for name, colour in colours.items()}
        ghosts = self._geometry.links if drawn is None else drawn.unknown
        self._measured.paint(colours_of_faults, None if observation.is_fresh else GREY, ghosts)
        self._encoders.show(self._geometry.links - ghosts)
        endpoint = observation.endpoint
        covariance = np.full((3, 3), np.nan) if endpoint is None else endpoint.covariance[:3, :3]
        level = np.full(3, np.nan) if endpoint is None else endpoint.protection_level[:3]
        pose = np.full(7, np.nan) if endpoint is None else endpoint.pose
        is_here = observation.is_fresh and endpoint is not None and endpoint.frame == self._geometry.base
        self._endpoint.visible = is_here and bool(np.isfinite(pose).all())
        self._ellipsoid.visible = self._endpoint.visible and bool(np.isfinite(covariance).all())
        self._protection.visible = self._endpoint.visible and bool(np.isfinite(level).all())
        T_base_endpoint = pin.SE3.Identity()
        if drawn is not None:
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
