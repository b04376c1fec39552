"""What a pack is made of, in figures (`pack_facts`) and as a page to read (`print_facts`, `print_findings`).

Sizes are triples (x, y, z). On a terminal the page is coloured and boxed; elsewhere it is plain "name:
value" lines.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import prod
from typing import Any

import numpy as np
from rich.bar import Bar
from rich.console import Console, RenderableType
from rich.filesize import decimal
from rich.table import Table
from rich.text import Text

from console.streams import one_line
from scenepack.blocks import block_data
from scenepack.check import Finding
from scenepack.files import INDICES_NAME, PARAMS_NAME, PackFiles, stored_bytes
from scenepack.pack import Pack

ALPHA_BINS = 8  # of 32 steps each; alpha 0 is counted apart
LONGEST_TEXT, MOST_ROWS = 200, 100  # of metadata
BAR_WIDTH = 24
MARKS = {"ok": ("✓", "green"), "note": ("·", "cyan"), "warning": ("!", "yellow"), "error": ("✗", "bold red")}


def pack_facts(files: PackFiles, pack: Pack) -> dict[str, Any]:
    """Figures about a pack, ready for JSON: sizes in voxels and bytes, world units, pixels."""
    alpha = alpha_histogram(pack)
    voxels = prod(pack.grid_size)
    dense = 4 * len(pack.atlases) * voxels  # bytes, of a value each
    memory = pack.atlas_indices.nbytes + sum(atlas.nbytes for atlas in pack.atlases)
    occupied = int(pack.occupied.sum())
    disk = stored_bytes(files.path)
    return {
        "path": str(files.path),
        "grid": list(pack.grid_size),
        "voxel_size": pack.voxel_size,
        "min_xyz": pack.min_xyz.tolist(),
        "max_xyz": pack.max_xyz.tolist(),
        "block_size": pack.block_size,
        "atlas": list(pack.atlas_rgba.shape[2::-1]),
        "atlas_blocks": list(pack.atlas_blocks),
        "macroblocks": {
            "grid": int(pack.occupied.size),
            "occupied": occupied,
            "atlas": prod(pack.atlas_blocks),
        },
        "voxels": {"grid": voxels, "stored": occupied * pack.block_size**3, "with_alpha": int(alpha[1:].sum())},
        "alpha_histogram": alpha[1:].tolist(),
        "bytes": {
            "disk": disk, **bytes_by_part(files), "memory": memory, "dense_8bit": dense, "dense_float32": 4 * dense,
        },
        "compression": {
            "against_dense_8bit": dense / max(disk, 1), "against_dense_float32": 4 * dense / max(disk, 1),
        },
        "features": pack.atlas_features is not None,
        "view_mlp": pack.view_mlp is not None,
        "ndc": pack.ndc,
        "contraction": pack.contraction,
        "input": {"width": pack.input_width, "height": pack.input_height, "focal": pack.input_focal},
        "worldspace_T_opengl": pack.worldspace_T_opengl.tolist(),
        "metadata": dict(pack.metadata),
    }  # fmt: skip


def alpha_histogram(pack: Pack) -> np.ndarray:
    """int64 [256]: how many stored voxels, padding left out, have each alpha."""
    counts = np.zeros(256, np.int64)
    for block in np.argwhere(pack.occupied).tolist():
        alpha = block_data(pack, pack.atlas_rgba, tuple(block))[..., 3]
        counts += np.bincount(alpha.ravel(), minlength=256)
    return counts


def bytes_by_part(files: PackFiles) -> dict[str, int]:
    parts: dict[str, int] = {"rgba": 0, "feature": 0, "indices": 0, "params": 0, "other": 0}
    for name, size in files.sizes.items():
        prefix = {PARAMS_NAME: "params", INDICES_NAME: "indices"}.get(name, name.partition("_")[0])
        prefix = {"rgb": "rgba", "alpha": "rgba", "occupied": "rgba"}.get(prefix, prefix)  # codecs that keep them apart
        parts[prefix if prefix in parts else "other"] += size
    return parts


def print_facts(facts: Mapping[str, Any], console: Console) -> None:
    """The page of `snerg-pack info`."""
    for title, rows in _sections(facts):
        page = [(Text(label), Text(value)) for label, value in rows]
        names = [label or rows[i - 1][0] for i, (label, _) in enumerate(rows)]
        plain = [f"{title}: {name.strip()}: {value}" for name, (_, value) in zip(names, rows, strict=True)]
        _print(console, plain, page, title.upper())
    counts, edges = facts["alpha_histogram"], np.linspace(0, 256, ALPHA_BINS + 1).astype(int)
    bins = {f"{max(a, 1):3d}-{b - 1:3d}": sum(counts[max(a - 1, 0) : b - 1]) for a, b in pairwise(edges)}
    most, total = max(*bins.values(), 1), max(sum(bins.values()), 1)
    page = [
        (label, Bar(most, 0, count, width=BAR_WIDTH, color="green"), f"{100 * count / total:5.1f} %")
        for label, count in bins.items()
    ]
    plain = [f"alpha: {label.replace(' ', '')}: {count}" for label, count in bins.items()]
    _print(console, plain, page, "ALPHA OF STORED VOXELS")


def print_findings(findings: Sequence[Finding], console: Console) -> None:
    """The page of `snerg-pack check`: a line for each rule."""
    plain = [f"{each.severity}: {each.rule}: {each.message}" for each in findings]
    page = [(Text(*MARKS[each.severity]), Text(each.rule, "bold"), Text(each.message)) for each in findings]
    _print(console, plain, page)


def _print(console: Console, plain: Sequence[str], page: Sequence[Sequence[RenderableType]], title: str = "") -> None:
    """Rows of `page` on a terminal, plain lines elsewhere."""
    if not console.is_terminal:
        for line in plain:
            console.print(line, markup=False, highlight=False, soft_wrap=True, emoji=False)
        return
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column(style="cyan", no_wrap=True)
    for row in page:
        table.add_row(*row)
    console.print(*([Text(title, "bold"), table, ""] if title else [table]), sep="\n")


def _sections(facts: Mapping[str, Any]) -> list[tuple[str, list[tuple[str, str]]]]:
    blocks, voxels, sizes, ratio = (facts[key] for key in ("macroblocks", "voxels", "bytes", "compression"))
    low, high = facts["min_xyz"], facts["max_xyz"]
    grid = [
        ("grid", f"{_by(facts['grid'])} voxels of {facts['voxel_size']:.6g} world units"),
        ("box (x × y × z)", " × ".join(f"{a:.4g} … {b:.4g}" for a, b in zip(low, high, strict=True))),
        ("block size", f"{facts['block_size']} voxels, {facts['block_size'] + 2} with padding"),
        ("macroblocks", _of(blocks["occupied"], blocks["grid"], "occupied")),
        ("atlas", f"{_by(facts['atlas'])} voxels, {_by(facts['atlas_blocks'])} blocks"),
        ("atlas in use", _of(blocks["occupied"], blocks["atlas"], "blocks")),
        ("voxels with alpha", _of(voxels["with_alpha"], voxels["grid"], "of the grid")),
        ("", _of(voxels["with_alpha"], voxels["stored"], "of the stored")),
    ]
    if facts["contraction"] is not None:
        grid.insert(2, ("contraction", f"of space beyond ±{facts['contraction']:.6g} world units"))
    storage = [("on disk", decimal(sizes["disk"]))]
    named = {"rgba": "rgba images", "feature": "feature images", "indices": "indices", "params": "JSON"}
    storage += [(f"  {named.get(part, part)}", decimal(sizes[part])) for part in (*named, "other") if sizes[part]]
    storage.append(("decoded", decimal(sizes["memory"])))
    for label, dense in (("dense, 8 bit", "dense_8bit"), ("dense, float", "dense_float32")):
        storage.append((label, f"{decimal(sizes[dense])}, {ratio[f'against_{dense}']:.1f} times the disk size"))
    view = "34 → 16 → 16 → 3" if facts["view_mlp"] else "none: diffuse"
    rows = "; ".join(" ".join(f"{v:.4g}" for v in row) for row in facts["worldspace_T_opengl"])
    camera = facts["input"]
    pixels = [f"{name} {camera[name]:g}" for name in ("width", "height", "focal") if camera[name] is not None]
    shading = [
        ("view MLP", view),
        ("features", "4 channels" if facts["features"] else "none"),
        ("frame", rows),
        ("forward-facing", "yes (NDC)" if facts["ndc"] else "no"),
        ("photographs", ", ".join(pixels) + " pixels" if pixels else "unknown"),
    ]
    sections = [("grid", grid), ("storage", storage), ("shading", shading)]
    if facts["metadata"]:
        entries = [
            (one_line(name, LONGEST_TEXT), one_line(text, LONGEST_TEXT)) for name, text in _flat(facts["metadata"])
        ]
        more = len(entries) - MOST_ROWS
        sections.append(("metadata", entries[:MOST_ROWS] + ([("…", f"{more} more")] if more > 0 else [])))
    return sections


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested metadata as rows; long lists are counted, not shown."""
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping) and len(prefix.split(".")) < 3:
            rows += _flat(value, f"{name}.")
        elif isinstance(value, Mapping | list) and len(value) > 4:
            rows.append((name, f"{len(value)} entries"))
        else:
            rows.append((name, f"{value:.6g}" if isinstance(value, float) else str(value)))
    return rows


def _by(sides: Sequence[int]) -> str:
    return " × ".join(map(str, sides))


def _of(part: int, whole: int, what: str) -> str:
    return f"{part:,} of {whole:,} {what} ({100 * part / max(whole, 1):.3g} %)".replace(",", " ")
