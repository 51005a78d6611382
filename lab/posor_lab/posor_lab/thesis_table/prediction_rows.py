"""Rows of the thesis table: the errors that sections 8.2 to 8.4 predict, from the budgets of chapter 7."""

from __future__ import annotations

from typing import TYPE_CHECKING

from posor_lab.thesis_budgets.chapter5 import LEG_X
from posor_lab.thesis_budgets.motion_predictions import (
    CURVE_PEAK,
    PEAK_TO_VALLEY,
    dimensions,
    diode_budget,
    diode_error,
    increasing_errors,
    machining_centre_alpha,
    probe_budget,
    random_alpha,
    sensor_travel,
    straightness_error,
    total_z,
    twist_stage_alpha,
)
from posor_lab.thesis_data import URAD
from posor_lab.thesis_table.thesis_row import ThesisRow

if TYPE_CHECKING:
    from posor_lab.thesis_budgets.motion_predictions import MotionName

MICROINCHES = 1e-6
"""Of an inch: the predictions are in inch, as in the thesis."""
_TEXT_DISTANCE = 0.027
"""Mean distance across the diodes that sections 8.4.4 and 8.4.5 take for both tests [inch]."""


def prediction_rows() -> list[ThesisRow]:
    """Return the rows of sections 8.2 to 8.4 that predict an error.

    Raises:
        DataFileError: A table of the thesis cannot be read.

    """
    return [*_test_setup(), *_expected_errors(), *_straightness(), *_diode_terms(), *_probe_terms()]


def _test_setup() -> list[ThesisRow]:
    return [
        ThesisRow("8.2", "alpha, error of the machining centre", "urad", "81", machining_centre_alpha() / URAD),
        ThesisRow("8.2", "alpha, runout of the twist stage", "urad", "17", twist_stage_alpha() / URAD),
        ThesisRow("8.4.4", "alpha, random error in TWIS and GEN", "urad", "83", random_alpha() / URAD),
    ]


def _expected_errors() -> list[ThesisRow]:
    lever = dimensions()["lever_endpoint"]
    factor_of_x = "the thesis takes the factor of X on theta as .5/9, the model has .5/9.25 (table 5.4)"
    return [
        ThesisRow("8.4", "sigma_X of the diodes", "uin", "1572", diode_budget("induced_sigma_X_uin") / MICROINCHES),
        ThesisRow("8.4", "sigma_Z of the diodes", "uin", "207", diode_budget("induced_sigma_Y_uin") / MICROINCHES),
        ThesisRow(
            "8.4",
            "sigma_theta of the diodes",
            "urad",
            "111",
            diode_budget("induced_sigma_theta_urad") / URAD,
            factor_of_x,
        ),
        ThesisRow("8.4", "sigma_Z of the POSOR, end of the beam", "uin", "3914", total_z() / MICROINCHES, factor_of_x),
        ThesisRow("8.4", "sigma_alpha, increasing", "urad", "123", probe_budget("increasing", "alpha") / URAD),
        ThesisRow("8.4", "sigma_beta, increasing", "urad", "75", probe_budget("increasing", "beta") / URAD),
        ThesisRow("8.4", "sigma_alpha, random", "urad", "11", probe_budget("random", "alpha") / URAD),
        ThesisRow("8.4", "sigma_beta, random", "urad", "6", probe_budget("random", "beta") / URAD),
        ThesisRow(
            "8.4",
            "sigma_Y of the POSOR, increasing",
            "uin",
            "2505",
            lever * probe_budget("increasing", "beta") / MICROINCHES,
            "the thesis multiplies the rounded 75 urad",
        ),
        ThesisRow(
            "8.4", "sigma_Y of the POSOR, random", "uin", "200", lever * probe_budget("random", "beta") / MICROINCHES
        ),
    ]


def _straightness() -> list[ThesisRow]:
    lever = dimensions()["lever_endpoint"]
    rows = [
        ThesisRow(
            "8.4",
            f"theta, stage straightness over {PEAK_TO_VALLEY} in of travel",
            "urad",
            "189",
            straightness_error() / URAD,
        )
    ]
    travels: tuple[tuple[MotionName, str, str], ...] = (
        ("ZMO", "8.4.1", "68"),
        ("YMO", "8.4.2", "53"),
        ("YZMO", "8.4.3", "45"),
    )
    for test, section, printed in travels:
        exact = sensor_travel(test).mean_x
        rounded = round(exact, 3)
        rows.append(
            ThesisRow(
                section,
                f"{test}: theta, stage straightness over {rounded} in",
                "urad",
                printed,
                straightness_error(rounded) / URAD,
                f"mean travel along X in table 8.1: {exact:.5f} in, which the text rounds to {rounded}; "
                f"not rounded: {straightness_error(exact) / URAD:.1f} urad",
            )
        )
    twis, gen = sensor_travel("TWIS"), sensor_travel("GEN")
    gen_theta = straightness_error(gen.mean_x)
    needed = 120.0 * URAD / straightness_error() * PEAK_TO_VALLEY
    reason = (
        f"does not follow: the rule of the other tests gives {gen_theta / URAD:.1f} urad for the mean travel "
        f"{gen.mean_x:.5f} in of table 8.1; 120 urad needs {needed:.4f} in"
    )
    rows += [
        ThesisRow(
            "8.4.4",
            "TWIS: z, peak of a linearisation curve at the end of the beam",
            "in",
            ".0045",
            CURVE_PEAK * lever / LEG_X,
            f"the text quotes the travels .0055 and .0230 in, which are those of GEN; TWIS has {twis.mean_x:.4f} in in "
            f"the mean, which the rule of the other tests turns into {lever * straightness_error(twis.mean_x):.5f} in",
        ),
        ThesisRow("8.4.5", "GEN: theta, stage straightness", "urad", "120", gen_theta / URAD, reason),
        ThesisRow(
            "8.4.5",
            "GEN: z by stage straightness, end of the beam",
            "in",
            ".004008",
            lever * gen_theta,
            f"{reason}; {lever} in times the printed 120 urad is {lever * 120.0 * URAD:.6f} in",
        ),
    ]
    return rows


def _diode_terms() -> list[ThesisRow]:
    lever = dimensions()["lever_endpoint"]
    gen = sensor_travel("GEN").mean_distance
    twis = sensor_travel("TWIS").mean_distance
    distance = (
        f"with the .027 in of the text; table 8.1 gives {twis:.4f} in for TWIS and {gen:.4f} in for GEN, that is "
        f"{lever * diode_error(twis):.6f} and {lever * diode_error(gen):.6f} in at the end of the beam"
    )
    return [
        ThesisRow("8.4.1", "ZMO: theta, terms of table 7.9 over .020 in", "urad", "4", diode_error(0.020) / URAD),
        ThesisRow("8.4.2", "YMO: theta, terms of table 7.9 over .007 in", "urad", "2", diode_error(0.007) / URAD),
        ThesisRow("8.4.3", "YZMO: theta, terms of table 7.9 over .02 in", "urad", "4", diode_error(0.02) / URAD),
        ThesisRow("8.4.4", "TWIS: z, terms of table 7.9", "in", ".0002", lever * diode_error(_TEXT_DISTANCE), distance),
        ThesisRow("8.4.5", "GEN: theta, terms of table 7.9", "urad", "6", diode_error(_TEXT_DISTANCE) / URAD, distance),
        ThesisRow(
            "8.4.5", "GEN: z, terms of table 7.9", "in", ".000200", lever * diode_error(_TEXT_DISTANCE), distance
        ),
    ]


def _probe_terms() -> list[ThesisRow]:
    """Return the increasing errors of the probes (equations 5.21 to 5.25) over the ranges of table 8.1."""
    predicted = {test: increasing_errors(sensor_travel(test).slopes) for test in ("YMO", "YZMO", "TWIS", "GEN")}
    by_range = "over the probe ranges of table 8.1"
    across = abs(sensor_travel("TWIS").slopes.across)
    twis = (
        f"table 8.1 has {across:.4f} in between probes 2 and 3; the printed 44 urad and 735 uin both follow from "
        f"{44.0 * URAD / predicted['TWIS'].alpha * across:.4f} in"
    )
    along = {test: sensor_travel(test).slopes.along for test in ("YMO", "YZMO", "GEN")}
    return [
        ThesisRow("8.4.2", f"YMO: alpha, increasing {by_range}", "urad", "0", predicted["YMO"].alpha / URAD),
        ThesisRow("8.4.3", f"YZMO: alpha, increasing {by_range}", "urad", "0", predicted["YZMO"].alpha / URAD),
        ThesisRow("8.4.4", f"TWIS: alpha, increasing {by_range}", "urad", "44", predicted["TWIS"].alpha / URAD, twis),
        ThesisRow("8.4.5", f"GEN: alpha, increasing {by_range}", "urad", "6", predicted["GEN"].alpha / URAD),
        *(
            ThesisRow(
                section,
                f"{test}: beta, increasing {by_range}",
                "urad",
                "13",
                predicted[test].beta / URAD,
                f"table 8.1 has {along[test]:.5f} in between probe 1 and the mean of probes 2 and 3; 13 urad needs "
                f"{13.0 * URAD / predicted[test].beta * along[test]:.4f} in, for YMO and YZMO alike",
            )
            for test, section in (("YMO", "8.4.2"), ("YZMO", "8.4.3"))
        ),
        ThesisRow("8.4.4", f"TWIS: y, increasing {by_range}", "uin", "735", predicted["TWIS"].y / MICROINCHES, twis),
        ThesisRow(
            "8.4.5",
            f"GEN: y, increasing {by_range}",
            "uin",
            "167",
            predicted["GEN"].y / MICROINCHES,
            f"does not follow: beta of 5 urad, but table 8.1 has {along['GEN']:.4f} in between probe 1 and the mean of "
            f"probes 2 and 3, which makes {predicted['GEN'].beta / URAD:.1f} urad",
        ),
    ]
