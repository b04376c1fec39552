"""Writes packs, and changes what a pack on disk says of itself."""

import json
import os
import re
import zipfile
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from console import UserError
from console.atomic import recover_interrupted_write, replacing, try_folder, write_file
from console.command_line import writing_to
from console.json_text import read_json_file
from scenepack.blocks import grid_block_counts
from scenepack.codecs import Codec, chosen_quality, codec_named
from scenepack.codecs.images import encode_png
from scenepack.files import INDICES_NAME, PARAMS_NAME, PackFiles, open_files
from scenepack.pack import Pack
from scenepack.params import params_json, parse_params
from scenepack.piece_files import SETTINGS, encoding_jobs, settings_for

ENCODING_THREADS = min(8, os.cpu_count() or 1)
# Names that a pack may hold, whatever its codec, and what file browsers drop beside them.
_PACK_FILE = re.compile(
    r"scene_params\.json|atlas_indices\.\w+|(rgba|rgb|alpha|occupied|feature|features)(_w)?(_\d+)*\.\w+"
    r"|\.DS_Store|Thumbs\.db"
)
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # fixed, so that equal packs make equal files


def save_pack(
    pack: Pack,
    path: Path,
    *,
    codec: str = "png",
    quality: int | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> None:
    """Writes a pack to the folder `path`, or to one file where its name ends in .zip.

    A kill at any moment leaves the old pack or the new one. The JSON is pack.params with whatever has changed since; "snerg" gets
    version and codec where the pack is ours.
    codec: see scenepack.codecs; only PNG is the published layout. quality: 1 (worst) to 100, of codecs that lose something; by
    default the codec's own. on_progress(done, total) follows each piece.
    UserError where the disk is full or refuses, `path` holds anything that is no pack, a library that the codec needs is missing,
    or a number would be refused when it is read. ValueError for arrays that do not fit together, a bug of the caller.
    """
    _require_consistent(pack)
    chosen = codec_named(codec, "codec")
    _replace(path, _files(pack, chosen, chosen_quality(chosen, quality), on_progress))


def copy_pack(files: PackFiles, pack: Pack, path: Path) -> None:
    """Writes the files of a pack as they are, with the metadata of `pack`, which was read from them. Otherwise as save_pack."""
    text = json.dumps({**pack.params, "snerg": {"version": program_version(), **pack.metadata}}, default=_plain)

    def copied() -> Generator[tuple[str, bytes], None, None]:
        yield PARAMS_NAME, text.encode()
        for name, size in files.sizes.items():
            if name != PARAMS_NAME and _PACK_FILE.fullmatch(name):
                yield name, files.read(name, size)

    _replace(path, copied())


def _replace(path: Path, files: Generator[tuple[str, bytes], None, None]) -> None:
    """Writes a pack's files, names and contents; see save_pack."""
    path = Path(path).resolve()  # through symbolic links: what they point to is replaced, not the link
    as_zip = path.suffix.lower() == ".zip"
    with writing_to(path):
        recover_interrupted_write(path)
        _require_replaceable(path, as_zip)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path, folder=not as_zip, alone=True) as new, closing(files):
            if as_zip:
                _write_zip(new, files)
            else:
                for name, data in files:
                    (new / name).write_bytes(data)


def check_target(path: Path) -> None:
    """UserError where save_pack would refuse or fail to write `path`: for commands to ask before hours of work, not after."""
    path = path.resolve()
    with writing_to(path):
        recover_interrupted_write(path)
        _require_replaceable(path, path.suffix.lower() == ".zip")
        try_folder(path.parent)


def _require_consistent(pack: Pack) -> None:
    blocks, used = grid_block_counts(pack.grid_size, pack.block_size)[::-1], pack.atlas_indices[pack.occupied]
    fit = {array.dtype for array in (*pack.atlases, pack.atlas_indices)} == {np.dtype(np.uint8)}
    fit &= pack.atlas_indices.shape == (*blocks, 3) and len({atlas.shape for atlas in pack.atlases}) == 1
    if not fit or np.any(used >= np.array(pack.atlas_blocks)):
        raise ValueError(f"the arrays of a pack of {pack.grid_size} voxels do not fit together")
    if (pack.view_mlp is not None and pack.atlas_features is None) or (pack.ndc and not pack.input_focal):
        raise ValueError("a view MLP needs features, and a forward-facing pack a focal length")


def _require_replaceable(path: Path, as_zip: bool) -> None:
    """UserError where something lies at `path` that is not a pack: nobody's photographs are ever deleted."""
    if not path.name:
        raise UserError("is not a place for a pack", where=path, remedy="name a folder or a .zip")
    if not os.path.lexists(path):
        return
    if path.is_dir() == as_zip:
        found, expected = ("a folder", "a .zip") if as_zip else ("a file", "a folder")
        raise UserError("already exists", where=path, expected=expected, found=found, remedy="choose another name")
    if as_zip:
        if path.stat().st_size == 0:
            return
        try:
            open_files(path).close()
        except UserError as error:
            raise UserError("holds something that is not a pack, so it is not replaced", where=path,
                            remedy="remove it yourself, or choose another name") from error  # fmt: skip
        return
    names = sorted(os.listdir(path))
    foreign = [name for name in names if not _PACK_FILE.fullmatch(name)]
    if names and (foreign or PARAMS_NAME not in names):
        found = (foreign or names)[0] + (f" and {len(foreign) - 1} others" if len(foreign) > 1 else "")
        raise UserError("holds files that do not belong to a pack, so it is not replaced", where=path, found=found,
                        remedy="choose a new or empty folder")  # fmt: skip


def _files(
    pack: Pack, codec: Codec, quality: int | None, on_progress: Callable[[int, int], None] | None
) -> Generator[tuple[str, bytes], None, None]:
    """The pack's files in order, name and content; images are encoded ahead in threads."""
    metadata = {key: value for key, value in pack.metadata.items() if key != SETTINGS}
    how = settings_for(pack, codec, quality)
    jobs, settings = encoding_jobs(pack, codec, how), {} if codec.name == "png" else {SETTINGS: how}
    if metadata or settings or not pack.params:  # a pack made elsewhere keeps its keys as they are
        metadata = {"version": program_version(), **metadata, "codec": codec.name, **settings}
    # The published web viewer takes RGBA and RGB alike; RGBA is what most packs in the wild have.
    z, y, x = pack.atlas_indices.shape[:3]
    indices = np.full((z * y, x, 4), 255, np.uint8)
    indices[..., :3] = pack.atlas_indices.reshape(z * y, x, 3)
    text = json.dumps(params_json(pack, codec.name, metadata), default=_plain).encode()
    parse_params(text, PARAMS_NAME, lambda note: None)  # what is written can be read
    yield PARAMS_NAME, text
    yield INDICES_NAME, encode_png(indices)
    with (
        ThreadPoolExecutor(ENCODING_THREADS, "snerg-encode") as pool,
        closing(pool.map(lambda job: job(), jobs)) as encoded,  # type: ignore[type-var]  (a generator: cancels what is left)
    ):
        for done, files in enumerate(encoded, 1):
            yield from files
            if on_progress is not None:
                on_progress(done, len(jobs))


def _write_zip(path: Path, files: Iterator[tuple[str, bytes]]) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files:
            entry = zipfile.ZipInfo(name, _ZIP_DATE)
            # Images are compressed already.
            entry.compress_type = zipfile.ZIP_DEFLATED if name == PARAMS_NAME else zipfile.ZIP_STORED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)


def _plain(value: Any) -> Any:
    """NumPy values and paths in "snerg" as JSON."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} in the pack's metadata is no JSON")


def program_version() -> str:
    """The version of this installation of snerg."""
    try:
        return version("snerg")
    except PackageNotFoundError:  # running from a bare checkout
        return "0"


# --- Changing what a pack on disk says of itself ---


def metadata_writable(pack: Pack, path: Path) -> bool:
    """Whether `pack`, read from `path`, is a folder that snerg made and this user may change: others stay as they are."""
    file = path / PARAMS_NAME
    ours = isinstance(pack.params.get("snerg"), Mapping)
    return ours and file.is_file() and os.access(path, os.W_OK) and os.access(file, os.W_OK)


def write_metadata(folder: Path, key: str, value: Any) -> None:
    """Puts `value` under `key` of the "snerg" object of the pack in `folder`, atomically; None takes the key away.

    OSError where that fails, ValueError where the file has become something else meanwhile.
    """
    file = folder / PARAMS_NAME
    document = read_json_file(file)
    if not isinstance(document, dict) or not isinstance(document.get("snerg"), dict):
        raise ValueError(f"{file} is no pack of ours any more")
    document["snerg"].pop(key, None)
    if value is not None:
        document["snerg"][key] = value
    write_file(file, json.dumps(document))
