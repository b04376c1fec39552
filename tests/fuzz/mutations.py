"""What is done to a tree, as data: steps that are written down in a finding and done again the same way.

A step is a list: the name of a function below, then its arguments, all JSON. A step that does not fit the tree any more
(its file is gone, its JSON spoilt) does nothing, so that steps may be left out to find those that matter.
"""

import contextlib
import json
import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.fuzz import claims
from tests.fuzz.hostile import contents, raw_json
from tests.fuzz.png import png_chunks, png_of
from tests.fuzz.trees import ARCHIVE, Tree, zipped

Step = list[Any]
_PLACE, _AGAIN = "@here@", "@again@"


def apply(tree: Tree, steps: list[Step]) -> Tree:
    """The tree with all steps done. Those on ARCHIVE come last: the result then has the archive as its one file."""
    tree = dict(tree)
    inner = [step for step in steps if step[1] != ARCHIVE]
    outer = [step for step in steps if step[1] == ARCHIVE]
    for step in inner:
        _do(tree, step)
    if outer:
        tree = {ARCHIVE: zipped(tree)}
        for step in outer:
            _do(tree, step)
    return tree


def _do(tree: Tree, step: Step) -> None:
    name, file, *arguments = step
    if name in _TREE:
        _TREE[name](tree, file, *arguments)
    elif isinstance(data := tree.get(file), bytes):
        with contextlib.suppress(Exception):  # one step may have left nothing that another could change
            tree[file] = _FILE[name](data, *arguments)


def _swap(tree: Tree, file: str, other: str) -> None:
    if file in tree and other in tree:
        tree[file], tree[other] = tree[other], tree[file]


def _copy(tree: Tree, file: str, other: str) -> None:
    if other in tree:
        tree[file] = tree[other]


def _rename(tree: Tree, file: str, new: str) -> None:
    if file in tree:
        tree[new] = tree.pop(file)


def _put(data: bytes, at: int, text: str) -> bytes:
    new = bytes.fromhex(text)
    return data[:at] + new + data[at + len(new) :] if at < len(data) else data


def documents(data: bytes) -> tuple[Any, bool]:
    """The value of a JSON file, and whether it is one of lines. ValueError where it is neither."""
    text = data.decode()
    try:
        return json.loads(text), False
    except json.JSONDecodeError:
        return [json.loads(line) for line in text.splitlines()], True


def _json_set(data: bytes, path: list[Any], raw: str) -> bytes:
    return _edited(data, path, lambda inner, key: inner.__setitem__(key, _PLACE), raw)


def _json_drop(data: bytes, path: list[Any]) -> bytes:
    return _edited(data, path, lambda inner, key: inner.__delitem__(key))


def _json_again(data: bytes, path: list[Any], raw: str) -> bytes:
    """The key a second time, later, with another value."""
    return _edited(data, path, lambda inner, key: inner.__setitem__(_AGAIN, _PLACE), raw)


def _json_name(data: bytes, path: list[Any], new: str) -> bytes:
    return _edited(data, path, lambda inner, key: inner.__setitem__(new, inner.pop(key)))


def _edited(data: bytes, path: list[Any], change: Callable[[Any, Any], None], raw: str = "") -> bytes:
    document, lines = documents(data)
    holder = [document]
    inner: Any = holder
    for key in (whole := [0, *path])[:-1]:
        inner = inner[key]
    change(inner, whole[-1])
    texts = [json.dumps(value) for value in (holder[0] if lines else holder)]
    text = "\n".join(texts)
    again = json.dumps(path[-1]) if path else ""
    return text.replace(f'"{_AGAIN}"', again).replace(f'"{_PLACE}"', raw_json(raw)).encode("utf-8", "surrogatepass")


def _png_put(data: bytes, chunk: int, at: int, text: str) -> bytes:
    chunks = png_chunks(data)
    kind, payload = chunks[chunk]
    chunks[chunk] = kind, _put(payload, at, text)
    return png_of(chunks)


def _png_add(data: bytes, chunk: int, kind: str, text: str, times: int) -> bytes:
    chunks = png_chunks(data)
    chunks.insert(chunk, (kind.encode(), bytes.fromhex(text) * times))
    return png_of(chunks)


def _png_drop(data: bytes, chunk: int) -> bytes:
    chunks = png_chunks(data)
    del chunks[chunk]
    return png_of(chunks)


def _png_pixels(data: bytes, at: int, text: str) -> bytes:
    """Other bytes in the decompressed rows."""
    chunks = png_chunks(data)
    whole = zlib.decompress(b"".join(p for k, p in chunks if k == b"IDAT"))
    first = next(i for i, (k, _) in enumerate(chunks) if k == b"IDAT")
    rest = [(k, p) for k, p in chunks if k != b"IDAT"]
    return png_of([*rest[:first], (b"IDAT", zlib.compress(_put(whole, at, text), 1)), *rest[first:]])


def tensors(data: bytes) -> tuple[dict[str, Any], bytes]:
    """Header and body of a safetensors file."""
    (length,) = struct.unpack_from("<Q", data)
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def _tensor_header(data: bytes, path: list[Any], raw: str) -> bytes:
    header, body = tensors(data)
    text = _json_set(json.dumps(header).encode(), path, raw)
    return struct.pack("<Q", len(text)) + text + body


def _tensor(data: bytes, name: str, change: str, argument: Any) -> bytes:
    """One array removed, renamed or changed (see _changed); checksum and offsets are right."""
    from safetensors.numpy import load

    from training.checkpoints import _serialised, checksum

    arrays = load(data)
    step = tensors(data)[0]["__metadata__"]["step"]
    array = arrays.pop(name)
    if change != "remove":
        arrays[argument if change == "rename" else name] = _changed(array, change, argument)
    metadata = {"format": "1", "step": step, "crc32": checksum(arrays)}
    return b"".join(bytes(part) for part in _serialised(arrays, metadata))


def _changed(array: np.ndarray, change: str, argument: Any) -> np.ndarray:
    if change == "reshape":
        return array.reshape(argument)
    if change == "cut":
        return array[: len(array) // 2] if array.ndim else array
    if change == "more":
        return np.concatenate([array] * argument)
    if change == "type":
        with np.errstate(all="ignore"):
            return array.astype(argument)
    array = array.copy()
    if change == "fill":
        array[...] = np.asarray(argument).astype(array.dtype)
    elif change == "set":
        place, value = argument
        array.reshape(-1)[place] = np.asarray(value).astype(array.dtype)
    return array


def _npy_header(data: bytes, old: str, new: str) -> bytes:
    """Another word in an .npy's header, whose length is put right."""
    (length,) = struct.unpack_from("<H", data, 8)
    text = data[10 : 10 + length].replace(old.encode(), new.encode(), 1)
    return data[:8] + struct.pack("<H", len(text)) + text + data[10 + length :]


_TREE: dict[str, Callable[..., None]] = {
    "remove": lambda tree, file: tree.pop(file, None), "swap": _swap, "copy": _copy, "rename": _rename,
    "instead": lambda tree, file, special: tree.update({file: special}),
    "content": lambda tree, file, kind: tree.update({file: contents()[kind]}),
    "claim grid": claims.grid, "claim atlas": claims.atlas, "claim blocks": claims.blocks, "claim planes": claims.planes,
}  # fmt: skip
_FILE: dict[str, Callable[..., bytes]] = {
    "put": _put, "cut": lambda data, length: data[:length], "erase": lambda data, at, n: data[:at] + data[at + n :],
    "insert": lambda data, at, text, times: data[:at] + bytes.fromhex(text) * times + data[at:],
    "repeat": lambda data, at, n, times: data[:at] + data[at : at + n] * times + data[at + n :], "json set": _json_set,
    "json drop": _json_drop, "json again": _json_again, "json name": _json_name, "png put": _png_put, "png add": _png_add,
    "png drop": _png_drop, "png pixels": _png_pixels, "tensor": _tensor, "tensor header": _tensor_header,
    "npy header": _npy_header,
}  # fmt: skip
