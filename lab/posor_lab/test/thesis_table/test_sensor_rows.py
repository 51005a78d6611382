"""Rows of sensors and interferometers: reasons and plots."""

from __future__ import annotations

from posor_lab.thesis_table import sensor_rows

from .find_row import find_row


def test_the_humidity_of_the_appendix_states_its_condition() -> None:
    """Cross-checked with the index itself: at the temperature of the reason, 30 % change it by 1 ppm."""
    reason = find_row(sensor_rows.rows(), "App. 4A", "index of air, 30 %").reason
    assert "by 1 ppm in air of 46 C only" in reason
    assert "at 20 C, 1 ppm needs 117 %, more than there can be" in reason


def test_plots_have_the_numbers_of_the_calculators() -> None:
    plots = {plot.title.split(":")[0]: plot for plot in sensor_rows.plots()}
    assert list(plots)[:4] == ["4.2.1", "4.2.2", "4.3", "4A"]
    assert "numerical aperture 0.5" in plots["4.2.1"].csv
    assert "2500 Hz,1,2.479" in plots["4.3"].csv
    assert "order 9,1,198" in plots["7.4.2, figure 7.18"].csv
    assert len(plots) == 7
