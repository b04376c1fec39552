"""Decoder sandbox: decodes pieces in subprocesses and kills those that need more time or memory than a piece explains.

Files can make a decoder do far more work than their size suggests: hidden frames, samples that share bytes, repeated scans. No
check finds all of that, and no thread can be stopped inside a library. scenepack.decoding_process is the code of the subprocess.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping

import numpy as np

from console.child_process import ChildProcess, module_command
from scenepack.codecs.base import CodecError, Decoded, Shape

PATIENCE_S, BYTES_PER_S = 20.0, 2e6  # time limit of a decoder: PATIENCE_S + decoded bytes / BYTES_PER_S
SPARE_BYTES, TIMES_DECODED = 1 << 30, 12  # memory limit: SPARE_BYTES + TIMES_DECODED · decoded bytes
START_S = 120.0  # time limit of the start, on a busy machine
IDLE_S = 10.0  # idle processes end after this time
COMMAND = module_command("scenepack.decoding_process")
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
    ) -> Decoded:
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
    ) -> Decoded:
        """The decoded piece. CodecError if decoding fails or the process ends."""
        decoded = 4 * int(np.prod(shape)) * (2 if features else 1)
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
                parts = [self._part(shape) for _ in range(2 if features else 1)]
        except (OSError, EOFError, ValueError) as failure:
            what = f"did not come to an end within {seconds:.0f} s" if late.is_set() else "crashed"
            raise CodecError(f"its decoder {what}") from failure
        return parts[0], parts[1] if features else None

    def _part(self, shape: Shape) -> np.ndarray:
        part = np.empty((*shape, 4), np.uint8)
        if self.output.readinto(part.reshape(-1).data) < part.nbytes:  # type: ignore[attr-defined]  (a BufferedReader)
            raise EOFError
        return part
