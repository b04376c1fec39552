"""`snerg-pack`: look into packs and validate them (CONTRACT section 4)."""

from __future__ import annotations

import json as json_text
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from console import UserError, progress, run_command
from scenepack.check import check_pack
from scenepack.pack import Pack
from scenepack.reader import PackReader, open_pack
from scenepack.report import pack_facts, print_facts, print_findings

DESCRIPTION = "Look into baked scenes (packs): a folder with scene_params.json, or one .zip of it."


def info(pack: Path, /, json: Path | None = None) -> None:
    """Tells what a pack is made of: sizes, occupancy, storage, frame, view MLP, where it came from.

    Args:
        pack: The pack, a folder or a .zip.
        json: Also write the figures to this file, sizes in voxels and bytes; "-" prints them instead.
    """
    with open_pack(pack) as reader:
        facts = pack_facts(reader.files, _read(reader))
    if not _write_json(json, facts):
        print_facts(facts, Console())


def check(pack: Path, /, json: Path | None = None, strict: bool = False) -> None:
    """Validates a pack: index bounds, padding copies, premultiplied colours, atlas blocks shared or lost.

    Exit status 0 where it can be rendered as meant, 2 where it cannot.

    Args:
        pack: The pack, a folder or a .zip.
        json: Also write the findings to this file; "-" prints them instead.
        strict: Take warnings for errors, too.
    """
    with open_pack(pack) as reader:
        findings = check_pack(_read(reader))
    if not _write_json(json, {"path": str(pack), "findings": [finding.as_json() for finding in findings]}):
        print_findings(findings, Console())
    broken = [f for f in findings if f.severity == "error" or (strict and f.severity == "warning")]
    if broken:
        sys.stdout.flush()
        raise UserError(
            f"breaks {len(broken)} rules ({', '.join(f.rule for f in broken)})",
            where=pack,
            remedy="bake it again",
        )


def _read(reader: PackReader) -> Pack:
    with progress("reading", reader.total) as bar:
        return reader.read(lambda done, _total: bar.update(done))


def _write_json(path: Path | None, value: dict[str, Any]) -> bool:
    """Writes `value` where asked for; True where it went to stdout and nothing else should."""
    if path is None:
        return False
    text = json_text.dumps(value, indent=2)
    if str(path) == "-":
        print(text)
        return True
    try:
        path.write_text(text + "\n")
    except OSError as error:
        raise UserError(f"cannot be written: {error.strerror or error}", where=path) from error
    return False


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of `snerg-pack`."""
    return run_command({"info": info, "check": check}, prog="snerg-pack", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
