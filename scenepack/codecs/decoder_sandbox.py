"""Decoder sandbox: decodes pieces in subprocesses and kills those that need more time or memory than a piece explains.

Files can make a decoder do far more work than their size suggests: hidden frames, samples that share bytes, repeated scans. No
check finds all of that, and no thread can be stopped inside a library.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, BinaryIO

import numpy as np

from console.child_process import ChildProcess
from scenepack.codecs import CODECS, CodecError
from scenepack.codecs.base import Parts, Shape
from scenepack.codecs.images import decode_picture

PATIENCE_S, BYTES_PER_S = 20.0, 2e6  # time limit of a decoder: PATIENCE_S + decoded bytes / BYTES_PER_S
SPARE_BYTES, TIMES_DECODED = 1 << 30, 12  # memory limit: SPARE_BYTES + TIMES_DECODED · decoded bytes
START_S = 120.0  # time limit of the start, on a busy machine
IDLE_S = 10.0  # idle processes end after this time
COMMAND = [sys.executable, "-P", "-c", f"from {__name__} import serve; serve()"]
# One thread and few arenas each, for what is reserved counts as taken.
ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MALLOC_ARENA_MAX": "2"}

_idle: list[_Process] = []
_ending: threading.Timer | None = None
_lock = threading.Lock()


class Decoders:
    """Decodes pieces, from several threads at once, until close(), which must be called."""

    def __init__(self) -> None:
        self._busy: set[_Process] = set()
        self._stopped = False

    def decode(
        self, codec: str, files: Mapping[str, bytes], names: tuple[str, ...], shape: Shape, features: bool
    ) -> Parts:
        """Result of `decode` of the codec of that name.

        CodecError also if it takes too long or too much memory, crashes, or is stopped.
        """
        if self._stopped:
            raise CodecError("decoding was stopped")
        process = _taken() or _Process(COMMAND, environment=ENVIRONMENT)
        with _lock:
            self._busy.add(process)
        try:
            if self._stopped:  # meanwhile
                raise CodecError("decoding was stopped")
            answer = process.ask(codec, files, names, shape, features)
        except BaseException:
            process.close()
            raise
        finally:
            with _lock:
                self._busy.discard(process)
        with _lock:
            _idle.append(process)
        return answer

    def close(self) -> None:
        """Kills running decoders; their callers get a CodecError. Idle processes end later."""
        global _ending
        with _lock:
            self._stopped = True
            busy = list(self._busy)
        for process in busy:
            process.close()
        with _lock:
            if _ending is not None:
                _ending.cancel()
            _ending = threading.Timer(IDLE_S, _end_idle)
            _ending.daemon = True
            _ending.start()


def _taken() -> _Process | None:
    while True:
        with _lock:
            process = _idle.pop() if _idle else None
        if process is None or process.poll() is None:
            return process
        process.close()


def _end_idle() -> None:
    while (process := _taken()) is not None:
        process.close()


class _Process(ChildProcess):
    """The caller's side of one subprocess."""

    def ask(
        self, codec: str, files: Mapping[str, bytes], names: tuple[str, ...], shape: Shape, features: bool
    ) -> Parts:
        """The decoded piece. CodecError if decoding fails or the process ends."""
        decoded = 4 * int(np.prod(shape)) * (1 + features)
        seconds = START_S
        question = {"codec": codec, "names": names, "sizes": [len(files[name]) for name in names], "shape": shape,
                    "features": features, "memory": SPARE_BYTES + TIMES_DECODED * decoded}  # fmt: skip
        late = threading.Event()
        try:
            with self.killed_after(seconds) as late:
                self.send(question, *(files[name] for name in names))
                self.receive()  # it has begun
            seconds = PATIENCE_S + decoded / BYTES_PER_S
            with self.killed_after(seconds) as late:
                answer = self.receive()
                if "error" in answer:
                    error = CodecError(str(answer["error"]))
                    error.file = answer.get("file") if answer.get("file") in names else None
                    raise error
                return [self._part(shape) for _ in range(1 + features)]
        except (OSError, EOFError, ValueError) as failure:
            what = f"did not come to an end within {seconds:.0f} s" if late.is_set() else "crashed"
            raise CodecError(f"its decoder {what}") from failure

    def _part(self, shape: Shape) -> np.ndarray:
        part = np.empty((*shape, 4), np.uint8)
        if self.output.readinto(part.reshape(-1).data) < part.nbytes:
            raise EOFError
        return part


# --- In the subprocess ---


def serve() -> None:
    """The decoding side: answers until nobody can ask any more.

    It reads a line of JSON and the files' bytes from standard input and writes `{}` when it begins. It then writes a line of JSON
    and the decoded bytes, whose number both sides know, to standard output. It ends when its input ends.
    """
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
        parts = [np.ascontiguousarray(part, np.uint8).reshape(whole) for part in decoded]
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
