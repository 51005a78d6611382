"""Changing a calibration file: what is replaced, what stays, and what is never lost."""

from __future__ import annotations

import datetime as dt
import os
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from posor_estimator.core.calibrate.fit import fit
from posor_estimator.core.calibrate.procedure import Outcome
from posor_estimator.core.calibrate.recording import Recording
from posor_estimator.core.calibrate.replacement import JointCovariance, Part, Replacement
from posor_estimator.core.calibrate.result import Run, written
from posor_estimator.core.calibration.edit import edited, parsed
from posor_estimator.core.calibration.fit_record import Instrument
from posor_estimator.core.calibration.load import calibration_of, load_calibration
from posor_estimator.core.calibration.save import refuse_existing, save
from posor_estimator.core.calibration.strict_yaml import FastLoader, StrictLoader, read_yaml
from posor_estimator.core.forward import empty_scans
from posor_estimator.errors import CalibrationError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TEXT = """\
# a file of its owner's own hand
name: rig   # the old one
list:
- 1
- {a: 2, b: [3, 4]}   # in flow
nested:
    block:
      - x: 1
        y: [1.0,
            2.0]
      - x: 2
    # a comment at the end
empty: {}
last: |
  some
  text
"""


def nodes(node: Any) -> Iterator[tuple[Any, ...]]:
    """Return tag and place of a node and of all below it."""
    yield node.tag, node.start_mark.index, node.start_mark.line, node.end_mark.index, node.end_mark.line
    for child in node.value if isinstance(node, yaml.CollectionNode) else ():
        for part in child if isinstance(child, tuple) else (child,):
            yield from nodes(part)


@pytest.mark.parametrize("text", [TEXT, "a: 010\nb: 2e-5\nc: 1:30\nd: é µ\ne: 'quoted'\nf: &x [1, {g: .5}]\nh: *x\n"])
def test_both_readers_find_the_same_in_the_same_places(text: str) -> None:
    fast, slow = FastLoader(text), StrictLoader(text)
    found, expected = fast.get_single_node(), slow.get_single_node()
    assert list(nodes(found)) == list(nodes(expected))
    assert fast.construct_document(found) == slow.construct_document(expected)


def test_key_paths_are_read_as_they_are_printed() -> None:
    assert parsed("sensors[0].probes[1].tip") == ("sensors", 0, "probes", 1, "tip")
    assert parsed("maps.fitted[2][3]") == ("maps", "fitted", 2, 3)
    for wrong in ("", "a..b", "a[x]", "a[1", ".a", "a.[1]"):
        with pytest.raises(CalibrationError, match="is no key path"):
            parsed(wrong)


@pytest.mark.parametrize(
    ("key", "new", "old_line", "new_line"),
    [
        ("name", "new", "name: rig   # the old one", "name: new   # the old one"),
        ("list[0]", 7.5, "- 1", "- 7.5"),
        ("list[1].b", [5.0, 6e-07], "- {a: 2, b: [3, 4]}   # in flow", "- {a: 2, b: [5.0, 6.0e-07]}   # in flow"),
        ("list[1].c", {"deep": 1}, "- {a: 2, b: [3, 4]}   # in flow", "- {a: 2, b: [3, 4], c: {deep: 1}}   # in flow"),
        ("nested.block[1].x", {"value": 1.0, "unit": "m"}, "      - x: 2", "      - x: {value: 1.0, unit: m}"),
        ("empty.first", 1, "empty: {}", "empty: {first: 1}"),
    ],
)
def test_one_entry_changes_and_every_other_line_stays(key: str, new: Any, old_line: str, new_line: str) -> None:
    assert edited(TEXT, "rig", {key: new}).split("\n") == TEXT.replace(old_line + "\n", new_line + "\n").split("\n")


def test_blocks_are_replaced_and_added_where_they_belong() -> None:
    changed = edited(
        TEXT, "rig", {"nested.block[0]": {"x": 3}, "nested.more": {"k": [1, 2]}, "last": "short", "new": [{"a": 1}]}
    )
    assert yaml.safe_load(changed) == {
        "name": "rig",
        "list": [1, {"a": 2, "b": [3, 4]}],
        "nested": {"block": [{"x": 3}, {"x": 2}], "more": {"k": [1, 2]}},
        "empty": {},
        "last": "short",
        "new": [{"a": 1}],
    }
    for comment in ("# a file of its owner's own hand", "# the old one", "# in flow", "# a comment at the end"):
        assert comment in changed


def test_a_random_file_changes_in_the_one_entry_only(rng: np.random.Generator) -> None:
    def made(depth: int) -> Any:
        kind = rng.integers(3) if depth else 2
        if kind == 0:
            return {f"k{i}": made(depth - 1) for i in range(rng.integers(1, 4))}
        if kind == 1:
            return [made(depth - 1) for _ in range(rng.integers(1, 4))]
        return float(rng.normal())

    def paths(content: Any, key: str) -> list[str]:
        if isinstance(content, dict):
            return [key] + [p for name, part in content.items() for p in paths(part, f"{key}.{name}".lstrip("."))]
        if isinstance(content, list):
            return [key] + [p for i, part in enumerate(content) for p in paths(part, f"{key}[{i}]")]
        return [key]

    for trial in range(200):
        content = {"root": made(4), "other": made(2)}
        text = yaml.safe_dump(content, default_flow_style=[True, None, False][trial % 3], width=40)
        for key in rng.permutation(paths(content, "")[1:])[:4]:
            new = [{"v": [1.0, 2.0]}, "text: #", -1e-9][rng.integers(3)]
            part: Any = content
            expected = yaml.safe_load(yaml.safe_dump(content))
            *way, leaf = parsed(str(key))
            part = expected
            for step in way:
                part = part[step]
            part[leaf] = new
            assert yaml.safe_load(edited(text, "random", {str(key): new})) == expected


def test_what_hangs_together_by_an_alias_is_not_changed() -> None:
    text = "a: &same {value: 1.0, unit: m}\nb: *same\nc: {<<: *same, value: 2.0}\n"
    for key in ("a", "b.value", "a.value"):
        with pytest.raises(CalibrationError, match=r"^rig: .* cannot be changed alone; expected entries that stand by"):
            edited(text, "rig", {key: 3.0})


@pytest.mark.parametrize(
    ("key", "sentence"),
    [
        ("nested.blok[0].x", "rig, line 6, key nested: key 'blok' is missing."),
        ("list[5]", "rig, line 3, key list: entry 5 is missing."),
        ("name.first", "rig, line 2, key name: entry first is missing."),
    ],
)
def test_a_key_that_leads_nowhere_is_named(key: str, sentence: str) -> None:
    with pytest.raises(CalibrationError) as caught:
        edited(TEXT, "rig", {key: 1})
    assert str(caught.value) == sentence


# Saving.


def test_a_new_file_is_written_whole_and_an_old_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    refuse_existing(path, force=False)
    assert save(path, "one\n") is None
    assert path.read_text(encoding="utf-8") == "one\n"
    mask = os.umask(0)
    os.umask(mask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~mask
    for refuse in (lambda: save(path, "two\n"), lambda: refuse_existing(path, force=False)):
        with pytest.raises(CalibrationError) as caught:
            refuse()
        assert str(caught.value) == f"calibration file {path}: is there already; expected another name, or --force."
    assert path.read_text(encoding="utf-8") == "one\n"
    assert [file.name for file in tmp_path.iterdir()] == ["rig.yaml"]


def test_a_replaced_file_is_kept_under_the_next_free_number(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    save(path, "one\n")
    path.chmod(0o640)
    refuse_existing(path, force=True)
    assert save(path, "two\n", force=True) == tmp_path / "rig.yaml.1"
    assert save(path, "three\n", force=True) == tmp_path / "rig.yaml.2"
    assert {file.name: file.read_text(encoding="utf-8") for file in tmp_path.iterdir()} == {
        "rig.yaml": "three\n",
        "rig.yaml.1": "one\n",
        "rig.yaml.2": "two\n",
    }
    assert path.stat().st_mode & 0o777 == 0o640


def test_through_a_link_the_file_behind_it_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    real, link = tmp_path / "real" / "rig.yaml", tmp_path / "rig.yaml"
    save(real, "one\n")
    link.symlink_to(real)
    save(link, "two\n", force=True)
    assert link.is_symlink()
    assert real.read_text(encoding="utf-8") == "two\n"


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = tmp_path / "none" / "rig.yaml"
    with pytest.raises(CalibrationError, match=r"cannot be written: No such file or directory\.$"):
        save(path, "one\n")
    with pytest.raises(CalibrationError, match=r"its folder is not there; expected a folder that exists\.$"):
        refuse_existing(path, force=True)


# Results of procedures.


RUN = Run(
    procedure="bench",
    options={"loss": "huber"},
    instruments=[Instrument(topic="/laser", name="interferometer 7", sigmas=[1e-8])],
    date=dt.datetime(2026, 1, 31, 12, tzinfo=dt.UTC),
)
RECORDING = Recording(empty_scans(np.zeros(0, dtype=np.int64)), {}, "somewhere/monday", "ab" * 32)
SHIFT, TIP = "sensors[0].probes[0].zero_shift", "sensors[0].probes[0].tip"


def outcome() -> Outcome:
    found = fit(
        lambda p: np.array([p[0] - 0.5, p[0] - 0.7, p[1] - 1.0, p[1] + p[0] - 1.4]), np.zeros(2), "ab", "VV", np.ones(2)
    )
    covariance = np.array([[1e-6, 5e-10], [5e-10, 1e-12]])
    return Outcome(
        method="bench work",
        fits={"line": found},
        replacements=(
            Replacement(SHIFT, 0.123456789012345, 1e-3),
            Replacement(TIP, [-0.076, 1e-6, -4.9e-4], [1e-5, 2e-5, 0.0]),
        ),
        parts=(Part("sessions.today", {"note": "made", "zero_shifts": {"value": [0.0, 0.1, 0.2], "unit": "V"}}),),
        covariances=(JointCovariance((SHIFT, f"{TIP}[0]"), covariance),),
        warnings=("Mind the gap.",),
    )


def test_a_result_is_the_old_file_with_the_new_values_and_their_origin(rig_calibrations: dict[str, Path]) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    old = calibration_of(text, "old")
    new_text = written(text, "old", outcome(), RECORDING, RUN)
    new = calibration_of(new_text, "new")
    probe: Any = new.sensors[0].probes[0]  # type: ignore[attr-defined]
    assert (probe.zero_shift.value, probe.zero_shift.sigma, probe.zero_shift.unit) == (0.123456789012, 1e-3, "V")
    assert probe.tip.sigma == [1e-5, 2e-5, 0.0]
    assert new.sessions["today"].zero_shifts is not None
    assert new.version == 2
    [record] = new.fits
    assert (record.procedure, record.date, record.method) == ("bench", "2026-01-31T12:00:00Z", "bench work")
    assert (record.recording.name, record.recording.sha256) == ("monday", "ab" * 32)
    assert record.former == old.content_hash
    assert record.replaced == [SHIFT, TIP, "sessions.today"]
    assert record.instruments[0].name == "interferometer 7"
    assert record.residuals["line"].freedoms == 2
    np.testing.assert_allclose(record.covariances[0].matrix, outcome().covariances[0].matrix, rtol=1e-11)
    assert record.warnings == ["Mind the gap."]
    # Everything else is the old file, line by line.
    kept = [line for line in text.split("\n") if line in new_text.split("\n")]
    assert len(kept) > len(text.split("\n")) - 8
    again = calibration_of(written(new_text, "new", outcome(), RECORDING, RUN), "again")
    assert [fit_record.former for fit_record in again.fits] == [old.content_hash, new.content_hash]
    assert len({old.content_hash, new.content_hash, again.content_hash}) == 3


@pytest.mark.parametrize(
    ("replacement", "words"),
    [
        (Replacement("sensors[0].probes[9].tip", [0.0] * 3, 0.0), "sensors[0].probes[9].tip: there is no such key."),
        (Replacement("sensors[0].probes[0]", 0.0, 0.0), "sensors[0].probes[0]: is no quantity."),
        (
            Replacement("sensors[0].probes[0].axis", [0.0, 0.0, 2.0], 0.0),
            "axis [0.0, 0.0, 2.0] has length 2; expected a unit vector.",
        ),
        (Replacement(TIP, [0.0, 0.0], 0.0), "value has 2 numbers; expected 3 numbers."),
        (Replacement(SHIFT, float("nan"), 0.0), "nan is not finite; expected finite numbers."),
    ],
)
def test_a_result_that_cannot_be_is_refused(
    replacement: Replacement, words: str, rig_calibrations: dict[str, Path]
) -> None:
    text = rig_calibrations["printed"].read_text(encoding="utf-8")
    with pytest.raises(CalibrationError) as caught:
        written(text, "rig.yaml", Outcome("bench", {}, (replacement,)), RECORDING, RUN)
    assert str(caught.value).endswith(words)


# What files say of fits.


def record() -> dict[str, Any]:
    return {
        "procedure": "bench",
        "method": "by hand",
        "date": "2026-01-31T12:00:00Z",
        "recording": {"name": "monday", "sha256": "ab" * 32},
        "replaced": [SHIFT],
        "covariances": [{"entries": ["a", "b"], "rows": [[1.0], [0.5, 2.0]]}],
    }


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda r: r["recording"].update(sha256="12"), "sha256 '12'; expected 64 hexadecimal digits, or nothing."),
        (lambda r: r.update(date="yesterday"), "date 'yesterday'; expected such as '2026-01-31T12:00:00Z'."),
        (lambda r: r.update(replaced=[]), "has 0 entries; expected at least 1."),
        (lambda r: r["covariances"][0].update(rows=[[1.0]]), "1 rows; expected 2, one for each entry."),
        (
            lambda r: r["covariances"][0].update(rows=[[1.0], [2.0]]),
            "row has 1 numbers; expected 2, the lower triangle.",
        ),
        (
            lambda r: r["covariances"][0].update(rows=[[1.0], [2.0, 1.0]]),
            "it is no covariance; expected a positive semi-definite matrix.",
        ),
        (
            lambda r: r["covariances"][0].update(rows=[[1.0], [0.0, -1.0]]),
            "a variance is not positive; expected more than zero on the diagonal.",
        ),
        (lambda r: r.update(former="x"), "former 'x'; expected the content hash of the calibration before."),
    ],
)
def test_a_wrong_fit_record_is_refused(
    spoil: Any, sentence: str, tmp_path: Path, rig_calibrations: dict[str, Path]
) -> None:
    content = yaml.safe_load(rig_calibrations["printed"].read_text(encoding="utf-8"))
    fine = record()
    content |= {"version": 2, "fits": [fine]}
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    assert load_calibration(path).fits[0].covariances[0].matrix.tolist() == [[1.0, 0.5], [0.5, 2.0]]
    spoil(fine)
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    with pytest.raises(CalibrationError) as caught:
        load_calibration(path)
    assert str(caught.value).endswith(sentence)
    assert "key fits[0]" in str(caught.value)


def test_a_file_of_version_1_keeps_its_hash_and_may_not_tell_of_fits(
    tmp_path: Path, rig_calibrations: dict[str, Path]
) -> None:
    content = yaml.safe_load(rig_calibrations["printed"].read_text(encoding="utf-8"))
    path = tmp_path / "rig.yaml"
    hashes = []
    several: list[dict[str, Any]] = [{}, {"fits": []}, {"version": 2}]
    for changes in several:
        path.write_text(yaml.safe_dump({**content, **changes}, sort_keys=False), encoding="utf-8")
        hashes.append(load_calibration(path).content_hash)
    assert hashes[0] == load_calibration(rig_calibrations["printed"]).content_hash == hashes[1] != hashes[2]
    path.write_text(yaml.safe_dump({**content, "fits": [record()]}, sort_keys=False), encoding="utf-8")
    with pytest.raises(CalibrationError, match=r"key fits: fits in a file of version 1; expected version 2\.$"):
        load_calibration(path)


@pytest.mark.parametrize("text", ["3e-06", "1e5", "010", "1:30", "yes", "1.5", ".5", "null"])
def test_a_text_that_looks_like_a_number_stays_a_text(text: str) -> None:
    changed = edited("options: {wobble: none}\n", "bench", {"options.wobble": text})
    assert read_yaml(changed, "bench")[1] == {"options": {"wobble": text}}
