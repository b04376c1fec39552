"""`snerg-pack info|check|convert`: look into packs, validate and transcode them (docs/commands.md).

`export` and `compare` are added in baker.commands.pack, where all of `snerg-pack` is put together.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console

from console import UserError, check_results, progress, run_command, write_json
from scenepack.check import check_pack
from scenepack.codecs import chosen_quality, codec_named
from scenepack.pack import Pack
from scenepack.reader import PackReader, open_pack
from scenepack.report import pack_facts, print_facts, print_findings
from scenepack.writer import check_target, save_pack

DESCRIPTION = (
    "Inspects, checks and converts packs. A pack is a baked scene: a folder with scene_params.json, or one .zip."
)


def info(pack: Path, /, json: Path | None = None) -> None:
    """Prints what a pack contains: sizes, occupancy, storage, frame, view MLP, provenance.

    Args:
        pack: The pack, a folder or a .zip.
        json: Also write the figures to this file, sizes in voxels and bytes; "-" prints them instead of the text.
    """
    check_results(json)
    with open_pack(pack) as reader:
        facts = pack_facts(reader.files, read_with_progress(reader))
    if not write_json(json, facts):
        print_facts(facts, Console())


def check(pack: Path, /, json: Path | None = None, strict: bool = False) -> None:
    """Validates a pack: index bounds, padding, premultiplied colours, shared or unused atlas blocks.

    The exit status is 0 if the pack can be rendered as meant, and 2 if not.

    Args:
        pack: The pack, a folder or a .zip.
        json: Also write the findings to this file; "-" prints them instead of the text.
        strict: Treat warnings as errors.
    """
    check_results(json)
    with open_pack(pack) as reader:
        findings = check_pack(read_with_progress(reader))
    if not write_json(json, {"path": str(pack), "findings": [finding.as_json() for finding in findings]}):
        print_findings(findings, Console())
    broken = [f for f in findings if f.severity == "error" or (strict and f.severity == "warning")]
    if broken:
        sys.stdout.flush()
        raise UserError(
            f"breaks {len(broken)} rules ({', '.join(f.rule for f in broken)})", where=pack, remedy="bake it again"
        )


def convert(
    pack: Path, /, out: Path, codec: str = "avif", quality: int | None = None, png_level: int = 6, force: bool = False
) -> None:
    """Converts a pack to another codec: png (published layout), webp (lossless), avif, h264 or jpeg.

    Args:
        pack: The pack, a folder or a .zip.
        out: Folder of the new pack, or a file name that ends in .zip. A new pack replaces an old one when it is complete.
        codec: png (the published web viewer opens it), webp (lossless, about 60 % of PNG), avif (lossy, about a third of
            PNG), h264 (lossy, the paper's; needs PyAV) or jpeg (lossy).
        quality: Quality of a lossy codec, 1 (smallest) ... 100 (best). The default is 83 for avif, 85 for h264, 95 for jpeg.
        png_level: Compression level of PNG, 0 (fast, large) ... 9 (slow, small).
        force: Let a lossy codec replace the pack that is converted. What is lost then cannot be brought back.
    """
    if not 0 <= png_level <= 9:
        raise UserError("is out of range", where="--png-level", expected="0 to 9", found=png_level)
    lossy = chosen_quality(codec_named(codec, "--codec"), quality) is not None  # now, not after the work is done
    if lossy and not force and out.exists() and pack.exists() and out.samefile(pack):
        raise UserError(
            f"{codec} is lossy, and would replace the pack that is converted",
            where=out,
            remedy="choose another --out, a lossless --codec (png, webp), or add --force",
        )
    check_target(out)
    with open_pack(pack) as reader:
        before, stored = read_with_progress(reader), reader.files.stored_bytes
    with progress("encoding", 1) as bar:

        def on_progress(done: int, total: int) -> None:
            bar.update(done / total)

        save_pack(before, out, codec=codec, quality=quality, png_level=png_level, on_progress=on_progress)
    with open_pack(out) as reader:
        after = reader.files.stored_bytes
    print(f"{out}: {codec}, {after / 1e6:.2f} MB, {100 * after / max(stored, 1):.0f} % of {stored / 1e6:.2f} MB before")


def read_with_progress(reader: PackReader) -> Pack:
    with progress("reading", reader.total) as bar:
        return reader.read(lambda done, _total: bar.update(done))


COMMANDS: dict[str, Callable[..., None]] = {"info": info, "check": check, "convert": convert}


def main(args: Sequence[str] | None = None) -> int:
    """`snerg-pack` without `compare`; returns the exit status."""
    return run_command(COMMANDS, prog="snerg-pack", description=DESCRIPTION, args=args)


if __name__ == "__main__":
    sys.exit(main())
