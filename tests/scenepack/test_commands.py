"""snerg-pack: what it prints, what it writes, and its exit status."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from rich.console import Console

from baker.commands.pack import main as snerg_pack
from scenepack import Finding, Pack, check_pack, load_pack, open_pack, report, save_pack
from scenepack.blocks import block_copy
from scenepack.editing import Voxels, without
from scenepack.placement import NOT_MOVED, placement_of
from tests.messages import without_progress
from tests.scenepack.helpers import read_image, same_pack, small_pack, write_image, written
from tests.scenepack.random_packs import packs
from tests.scenepack.test_placement import UP, sloping_pack
from tests.scenepack.volumes import features_of

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Run:
    def call(*words: object) -> tuple[int, str, str]:
        status = snerg_pack([*map(str, words)])
        out, err = capsys.readouterr()
        return status, out, "".join(f"{line}\n" for line in without_progress(err))

    return call


@pytest.mark.parametrize("name", ["pack", "pack.zip"])
def test_info_prints_plain_lines_without_a_terminal(tmp_path: Path, run: Run, name: str) -> None:
    pack = small_pack().with_metadata(steps=250, scene="lego", cameras=[{"name": "a"}] * 9)
    status, out, err = run("info", written(tmp_path / name, pack))
    assert status == 0 and err == ""
    x, y, z = pack.grid_size
    assert f"grid: grid: {x} × {y} × {z} voxels" in out
    assert "metadata: steps: 250\n" in out and "metadata: cameras: 9 entries" in out
    assert all(line.count(": ") >= 2 for line in out.splitlines()) and "\x1b" not in out


def test_info_tells_the_contraction_and_convert_keeps_it(tmp_path: Path, run: Run) -> None:
    folder = written(tmp_path / "pack", small_pack().with_metadata(contraction=0.75))
    assert "grid: contraction: of space beyond ±0.75 world units\n" in run("info", folder)[1]
    assert run("convert", folder, "--out", tmp_path / "new", "--codec", "webp")[0] == 0
    assert load_pack(tmp_path / "new").contraction == 0.75
    assert "contraction" not in run("info", written(tmp_path / "plain", small_pack()))[1]


def test_what_metadata_say_reaches_no_terminal_but_as_plain_text(tmp_path: Path, run: Run) -> None:
    hostile = {
        "\x1b[31mred": "\x1b]0;title\x07\x9b2J",
        "long": "L" * (1 << 20),
        "lines": "a\nb: c\r",
        "markup": "[bold]x",
    }
    pack = small_pack().with_metadata(**hostile, provenance={f"key {i}": i for i in range(5000)})
    status, out, _ = run("info", written(tmp_path / "pack", pack))
    assert status == 0 and "[bold]x" in out and "more" in out
    assert all(c.isprintable() or c == "\n" for c in out) and len(out) < 20_000
    page = StringIO()
    with open_pack(tmp_path / "pack") as reader:
        report.print_facts(report.pack_facts(reader.files, reader.read()), Console(file=page, force_terminal=True))
    assert "\x1b]" not in page.getvalue() and "\x07" not in page.getvalue() and "\x9b" not in page.getvalue()


def test_info_figures_agree_with_the_files_and_the_voxels(tmp_path: Path, run: Run) -> None:
    pack = small_pack()
    folder = written(tmp_path / "pack", pack)
    status, out, _ = run("info", folder, "--json", tmp_path / "facts.json")
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert status == 0 and out
    sizes = facts["bytes"]
    assert sizes["disk"] == sum(f.stat().st_size for f in folder.iterdir())
    assert sizes["disk"] == sum(sizes[p] for p in ("rgba", "feature", "indices", "params", "other"))
    assert sizes["dense_float32"] == 4 * sizes["dense_8bit"] == 32 * np.prod(pack.grid_size)
    assert facts["macroblocks"]["occupied"] == pack.occupied.sum()
    assert facts["voxels"]["with_alpha"] == sum(facts["alpha_histogram"]) > 0
    assert run("info", folder, "--json", "-")[1] == (tmp_path / "facts.json").read_text()


def test_check_passes_a_sound_pack_and_writes_its_findings(tmp_path: Path, run: Run) -> None:
    folder = written(tmp_path / "pack", small_pack(style="borders", occupancy=1.0))
    status, out, err = run("check", folder, "--json", tmp_path / "f.json", "--strict")
    assert status == 0 and err == "" and "ok: shared: " in out
    rules = [finding["rule"] for finding in json.loads((tmp_path / "f.json").read_text())["findings"]]
    assert rules == [line.split(": ")[1] for line in out.splitlines()]


def test_strict_turns_warnings_into_status_two(tmp_path: Path, run: Run) -> None:
    folder = written(tmp_path / "pack")
    image = read_image(folder / "rgba_000.png")
    image[: image.shape[0] // 4, :8, 3] ^= 255  # the first plane is padding
    write_image(folder / "rgba_000.png", image)
    assert run("check", folder)[0] == 0
    status, _, err = run("check", folder, "--strict")
    assert status == 2 and err.count("\n") == 1 and "padding rgba" in err


def found(pack: Pack, rule: str) -> Finding:
    return next(finding for finding in check_pack(pack) if finding.rule == rule)


def spoiled(pack: Pack, part: str = "rgba") -> tuple[Pack, np.ndarray]:
    """A copy whose atlas may be written, and that atlas."""
    atlas = (pack.atlas_rgba if part == "rgba" else features_of(pack)).copy()
    return replace(pack, **{f"atlas_{part}": atlas}), atlas


@settings(max_examples=25, deadline=None)
@given(pack=packs(block_sizes=(2, 6, 14), ndc=None))
def test_sound_packs_have_neither_errors_nor_warnings(pack: Pack) -> None:
    if pack.occupied.any():
        assert {finding.severity for finding in check_pack(pack)} <= {"ok", "note"}


def test_a_wrong_padding_voxel_is_counted_once() -> None:
    for part in ("rgba", "features"):
        pack, atlas = spoiled(small_pack(), part)
        z, y, x = np.argwhere(pack.occupied[..., :-1] & pack.occupied[..., 1:])[0]
        copy = block_copy(pack, atlas, (z, y, x))
        copy[3, 3, -1, 3] += 7
        finding = found(pack, f"padding {part}")
        assert finding.severity == "warning"
        assert finding.figures["wrong_copies"] == 1 and finding.figures["worst"] == 7


def test_a_pack_that_repeats_its_own_borders_is_recognised() -> None:
    pack, atlas = spoiled(small_pack(occupancy=0.8))
    for block in np.argwhere(pack.occupied).tolist():
        copy = block_copy(pack, atlas, tuple(block))
        copy[...] = np.pad(copy[1:-1, 1:-1, 1:-1], [(1, 1), (1, 1), (1, 1), (0, 0)], mode="edge")
    figures = found(pack, "padding rgba").figures
    assert figures["wrong_copies"] > 0
    assert figures["own_border_repeated"] == figures["wrong_copies"] + figures["wrong_blanks"]


def test_colours_brighter_than_their_alpha_are_counted() -> None:
    pack, atlas = spoiled(small_pack())
    copy = block_copy(pack, atlas, tuple(np.argwhere(pack.occupied)[0]))
    copy[2, 2, 2] = (0, 50, 0, 10)
    finding = found(pack, "premultiplied")
    assert finding.severity == "warning" and finding.figures["broken"] == 1 and finding.figures["worst"] == 40


def test_atlas_blocks_used_twice_and_lost_ones_and_indices_outside_of_the_atlas_are_found() -> None:
    pack = small_pack(style="borders", occupancy=1.0)
    indices = pack.atlas_indices.copy()
    first, second = np.argwhere(pack.occupied)[:2]
    indices[tuple(second)] = indices[tuple(first)]
    spoiled_pack = replace(pack, atlas_indices=indices)
    assert found(spoiled_pack, "shared").figures["shared"] == 1
    assert found(spoiled_pack, "unused").figures["unreachable_with_content"] == 1
    indices[tuple(first)] = (200, 0, 0)
    findings = check_pack(spoiled_pack)
    assert [f.severity for f in findings] == ["error"] and findings[0].figures["outside"] == 1


def test_move_changes_what_the_pack_says_of_its_place_and_no_other_file(tmp_path: Path, run: Run) -> None:
    save_pack(sloping_pack(), tmp_path / "slope.zip", codec="webp")
    words = ("--up", "auto", "--turn", "-30", "--scale", "2.5m", "--origin", "-0.1,-0.4,0.2")
    status, out, _ = run("move", str(tmp_path / "slope.zip"), "--out", str(tmp_path / "new"), *words)
    assert status == 0 and "1 grid unit is 2.5 m" in out
    before, after = load_pack(tmp_path / "slope.zip"), load_pack(tmp_path / "new")
    placement = placement_of(after)
    assert np.arccos(placement.up @ UP) < np.radians(0.5) and placement.origin == (-0.1, -0.4, 0.2)
    assert placement.angles[0] - NOT_MOVED.levelled(placement.up).angles[0] == pytest.approx(-30.0, abs=0.1)
    assert after.metadata["marks"]["scale"] == {"factor": 2.5, "unit": "m"}
    assert np.array_equal(before.atlas_rgba, after.atlas_rgba)
    with zipfile.ZipFile(tmp_path / "slope.zip") as archive:
        for name in set(archive.namelist()) - {"scene_params.json"}:
            assert (tmp_path / "new" / name).read_bytes() == archive.read(name)
    assert run("move", str(tmp_path / "new"), "--out", str(tmp_path / "again.zip"), "--scale", "40cm")[0] == 0
    again = load_pack(tmp_path / "again.zip")
    assert placement_of(again) == placement and again.metadata["marks"]["scale"]["unit"] == "cm"


def test_edit_writes_a_pack_without_what_its_options_name_in_their_order(tmp_path: Path, run: Run) -> None:
    folder = written(tmp_path / "pack", small_pack(occupancy=0.06))
    words = ("--fainter-than", "0.3", "--keep-largest")
    status, out, err = run("edit", folder, "--out", tmp_path / "new.zip", *words)
    before, after = load_pack(folder), load_pack(tmp_path / "new.zip")
    assert status == 0 and f"{tmp_path / 'new.zip'}: without " in out and "png" in out, err
    left = without(before, Voxels(before).fainter_than(0.3), [])
    expected = without(left, Voxels(left).parts().smaller_than(), [])
    assert same_pack(after, expected)
    (edit,) = after.metadata["provenance"]["edits"]
    assert edit["how"] == ["--fainter-than 0.3", "--keep-largest"] and edit["voxels_removed"] > 0


def test_edit_never_replaces_the_pack_itself(tmp_path: Path, run: Run) -> None:
    folder = written(tmp_path / "pack")
    status, _, err = run("edit", folder, "--out", folder, "--keep-largest")
    assert status == 2 and "would replace the pack that is edited" in err and same_pack(load_pack(folder), small_pack())
