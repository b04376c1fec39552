"""The validation report finds each kind of damage, and nothing in a sound pack."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings

from scenepack import Finding, Pack, check_pack, load_pack
from scenepack.blocks import block_copy
from tests.scenepack.helpers import real_pack, small_pack
from tests.scenepack.random_packs import packs


def found(pack: Pack, rule: str) -> Finding:
    return next(finding for finding in check_pack(pack) if finding.rule == rule)


def spoiled(pack: Pack, part: str = "rgba") -> tuple[Pack, np.ndarray]:
    """A copy whose atlas may be written, and that atlas."""
    atlas = (pack.atlas_rgba if part == "rgba" else pack.atlas_features).copy()  # type: ignore[union-attr]
    return replace(pack, **{f"atlas_{part}": atlas}), atlas


@settings(max_examples=25, deadline=None)
@given(pack=packs(block_sizes=(2, 6, 14), ndc=None))
def test_sound_packs_have_neither_errors_nor_warnings(pack: Pack) -> None:
    if pack.occupied.any():
        assert {finding.severity for finding in check_pack(pack)} <= {"ok", "note"}


def test_a_wrong_padding_voxel_is_counted_once() -> None:
    for part in ("rgba", "features"):
        pack, atlas = spoiled(small_pack(), part)
        blocks = np.argwhere(pack.occupied)
        here = next(
            b for b in blocks.tolist() if b[2] + 1 < pack.grid_blocks[0] and pack.occupied[b[0], b[1], b[2] + 1]
        )
        copy = block_copy(pack, atlas, tuple(here))
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


def test_indices_outside_of_the_atlas_are_an_error() -> None:
    pack = small_pack()
    indices = pack.atlas_indices.copy()
    indices[tuple(np.argwhere(pack.occupied)[0])] = (200, 0, 0)
    findings = check_pack(replace(pack, atlas_indices=indices))
    assert [f.severity for f in findings] == ["error"] and findings[0].figures["outside"] == 1


def test_atlas_blocks_used_twice_and_lost_ones_are_found() -> None:
    pack = small_pack(style="borders", occupancy=1.0)
    indices = pack.atlas_indices.copy()
    first, second = np.argwhere(pack.occupied)[:2]
    indices[tuple(second)] = indices[tuple(first)]
    spoiled_pack = replace(pack, atlas_indices=indices)
    assert found(spoiled_pack, "shared").figures["shared"] == 1
    assert found(spoiled_pack, "unused").figures["unreachable_with_content"] == 1


def test_the_pack_made_elsewhere_has_no_errors() -> None:
    findings = check_pack(load_pack(real_pack()))
    assert not [finding for finding in findings if finding.severity == "error"]
