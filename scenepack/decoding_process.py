"""The decoding subprocess of scenepack.codecs.decoder_sandbox.

It reads a line of JSON and the files' bytes from standard input and writes `{}` when it begins. It then writes a line of JSON and
the decoded bytes, whose number both sides know, to standard output. It ends when its input ends.
"""

import json
import os
import queue
import sys
import threading
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np

from scenepack.cameras import decode_picture
from scenepack.codecs import CODECS, CodecError


def serve() -> None:
    """The decoding side: answers until nobody can ask any more."""
    source, target = sys.stdin.buffer, sys.stdout.buffer
    questions: queue.SimpleQueue[tuple[dict[str, Any], dict[str, bytes]]] = queue.SimpleQueue()

    def listen() -> None:
        """Beside the decoder, so that this process ends with the one that asks, even amid a decoder's loop."""
        while line := source.readline():
            question = json.loads(line)
            sizes = zip(question["names"], question["sizes"], strict=True)
            questions.put((question, {name: source.read(size) for name, size in sizes}))
        os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    while True:
        question, files = questions.get()
        target.write(b"{}\n")
        target.flush()
        _answer(question, files, target)
        target.flush()


def _answer(question: dict[str, Any], files: dict[str, bytes], target: BinaryIO) -> None:
    decode = CODECS[question["codec"]].decode if question["codec"] in CODECS else decode_picture
    _limit_memory(question["memory"])
    answer, parts = dict[str, Any](), list[np.ndarray]()
    try:
        decoded = decode(files, tuple(question["names"]), tuple(question["shape"]), question["features"])
        whole = (*question["shape"], 4)
        parts = [np.ascontiguousarray(part, np.uint8).reshape(whole) for part in decoded if part is not None]
    except CodecError as error:
        answer = {"error": str(error)[:1000], "file": error.file}
    except MemoryError:
        answer = {"error": "its decoder takes more memory than its size explains"}
    target.write(json.dumps(answer).encode() + b"\n")
    for part in parts:
        target.write(part.reshape(-1).data)


def _limit_memory(more: int) -> None:
    """Lets this process allocate no more than so many bytes beside what it has; where the system can do that."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        with open("/proc/self/statm") as file:
            taken = int(file.read().split()[0]) * resource.getpagesize()
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (taken + more, hard))


if __name__ == "__main__":
    serve()
