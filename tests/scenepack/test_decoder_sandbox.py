"""A decoder that takes more time or memory than what it decodes explains is ended, and whoever asked goes on."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from console import UserError
from scenepack import load_pack, save_pack
from scenepack.codecs import decoder_sandbox
from tests.scenepack.helpers import small_pack
from tests.viewer.waiting import is_gone, until

ROOT = Path(__file__).parents[2]
HANGS, CRASHES = "while True: pass", "os.kill(os.getpid(), signal.SIGSEGV)"
EATS = "held = [bytes([1]) * (1 << 28) for _ in range(40)]"
SPOILT = """
import os, signal
from scenepack.codecs.decoder_sandbox import serve
from scenepack.codecs.images import WebpCodec
def decode(*_):
    open({began!r}, "w").write(str(os.getpid()))
    {lines}
WebpCodec.decode = decode
serve()
"""
INTERRUPTED = """
import sys
from pathlib import Path
from scenepack import load_pack
from scenepack.codecs import decoder_sandbox
decoder_sandbox.COMMAND, decoder_sandbox.PATIENCE_S = [sys.executable, "-P", "-c", sys.argv[2]], 3600.0
load_pack(Path(sys.argv[1]))
"""


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sandbox") / "pack"
    save_pack(small_pack(), folder, codec="webp")
    return folder


@pytest.fixture
def decoder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Callable[[str], Path]]:
    """Lets `lines` be what decodes WebP; gives the file that holds the number of the process that began to."""
    decoder_sandbox._end_idle()

    def replace(lines: str) -> Path:
        began = tmp_path / "began"
        code = SPOILT.format(began=str(began), lines=lines)
        monkeypatch.setattr(decoder_sandbox, "COMMAND", [sys.executable, "-P", "-c", code])
        return began

    yield replace
    decoder_sandbox._end_idle()


@pytest.mark.parametrize("lines, message", [(HANGS, "did not come to an end within"), (CRASHES, "crashed")])
def test_a_decoder_that_hangs_or_crashes_is_an_error_that_names_the_file(pack, decoder, monkeypatch, lines, message):
    monkeypatch.setattr(decoder_sandbox, "PATIENCE_S", 0.5)
    began = decoder(lines)
    with pytest.raises(UserError, match=rf"rgba_00\d_0\.webp: cannot be decoded: its decoder {message}"):
        load_pack(pack)
    assert is_gone(int(began.read_text()))


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is limited on Linux alone")
def test_a_decoder_that_takes_all_memory_is_an_error(pack: Path, decoder: Callable[[str], Path]) -> None:
    decoder(EATS)
    with pytest.raises(UserError, match="more memory than its size explains"):
        load_pack(pack)


def test_ctrl_c_ends_a_decoder_that_hangs(pack: Path, tmp_path: Path) -> None:
    began = tmp_path / "began"
    words = [sys.executable, "-c", INTERRUPTED, str(pack), SPOILT.format(began=str(began), lines=HANGS)]
    process = subprocess.Popen(words, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    try:
        until(lambda: began.exists() and bool(began.read_text()))
        process.send_signal(signal.SIGINT)
        _, words_said = process.communicate(timeout=120)  # far below a decoder's patience here
    finally:
        process.kill()
    assert process.returncode != 0 and "KeyboardInterrupt" in words_said
    assert is_gone(int(began.read_text()))


@pytest.mark.slow
def test_a_program_that_ends_takes_its_decoders_along_and_does_not_wait_for_them(pack: Path, tmp_path: Path) -> None:
    """As when the window closes, or the program is killed, while a pack is being opened in a thread."""
    began = tmp_path / "began"
    ends = f"""
import threading
threading.Thread(target=lambda: load_pack(Path(sys.argv[1])), daemon=True).start()
import os, time
while not (os.path.exists({str(began)!r}) and os.path.getsize({str(began)!r})): time.sleep(0.01)
"""
    code = INTERRUPTED.rsplit("load_pack(", 1)[0] + ends
    words = [sys.executable, "-c", code, str(pack), SPOILT.format(began=str(began), lines=HANGS)]
    assert subprocess.run(words, cwd=ROOT, timeout=120).returncode == 0
    until(lambda: is_gone(int(began.read_text())))


def test_decoders_are_used_again_and_those_that_were_killed_are_replaced(tmp_path: Path) -> None:
    save_pack(small_pack(), tmp_path / "pack", codec="jpeg")
    decoder_sandbox._end_idle()
    load_pack(tmp_path / "pack")
    kept = list(decoder_sandbox._idle)
    load_pack(tmp_path / "pack")
    assert {process.pid for process in decoder_sandbox._idle} & {process.pid for process in kept}
    for process in decoder_sandbox._idle:
        os.kill(process.pid, signal.SIGKILL)  # as a machine does that runs out of memory
    until(lambda: not any(process.poll() is None for process in decoder_sandbox._idle))
    load_pack(tmp_path / "pack")
