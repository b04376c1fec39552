"""Options and caches that all tests share."""

import gc
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from tests.compiling import as_users_have_it, compile_once_and_quickly
from tests.messages import without_progress
from tests.scenepack.helpers import written
from tests.viewer.rendering.shapes import shapes_pack, surroundings_pack
from training.libraries import release_freed_memory

settings.register_profile("busy machine", deadline=None, max_examples=50)  # how long one takes says nothing there
settings.load_profile("busy machine")

TIME_IS_UP = "SNERG_TESTS_END_AT"  # seconds since 1970, set by .ci/run
HELD = 3 << 29  # bytes of a process beyond which it lets go of the programs that it compiled


def pytest_configure(config: pytest.Config) -> None:
    """Programs that tests start take Ctrl-C and hang-ups from here: what runs in a shell's background, or under nohup,
    ignores them, and so do its children.
    """
    if threading.current_thread() is threading.main_thread():
        for number, handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
            if signal.getsignal(number) is signal.SIG_IGN:
                signal.signal(number, handler)
    if not hasattr(config, "workerinput"):  # workers have it from the process that starts them
        compile_once_and_quickly(config.add_cleanup)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests go first: one that begins last would keep one worker busy while the others wait.

    Before them, one file compiles nearly all loops of training and baking, beside tests that compile none: each would be
    compiled twice otherwise.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    here = Path(__file__).parent
    compiling, viewer = here / "baker" / "baking" / "test_captures.py", here / "viewer"
    items.sort(key=lambda item: (item.path != compiling, viewer not in item.path.parents, item.path not in slow))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """CI gives the slow tests some minutes, and runs as many of them as that is enough for."""
    until = os.environ.get(TIME_IS_UP)
    if until is not None and time.time() > float(until):
        pytest.skip("the time for slow tests is up; make test-all runs them all")


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("golden pictures")
    group.addoption("--regenerate-golden", action="store_true", help="rewrite tests/golden from what is rendered now")
    group.addoption(
        "--require-golden",
        action="store_true",
        help="fail where golden pictures or real data cannot be compared, instead of skipping; always on where CI is set",
    )


@pytest.fixture(scope="module", autouse=True)
def _programs_are_let_go() -> Iterator[None]:
    """JAX keeps each program that it ever compiled: gigabytes by the end of all tests. What is needed again lies on the disk."""
    yield
    memory = Path("/proc/self/statm")  # which Linux alone has
    held = int(memory.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if memory.exists() else 0
    if "jax" in sys.modules and held > HELD:
        sys.modules["jax"].clear_caches()
        gc.collect()
        release_freed_memory()


@pytest.fixture
def hardly_optimised() -> Iterator[None]:
    """For tests that compile much and run it once or twice: how fast it runs does not matter at all."""
    import jax

    jax.config.update("jax_disable_most_optimizations", True)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture
def compiled_as_for_users() -> Iterator[None]:
    """For tests of numbers that repeat to the last bit: quick compilers might repeat them where the usual one does not."""
    with as_users_have_it():
        yield


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """refused(main, *words): the one line in which a command refuses its words, with exit status 2."""

    def line_of(main: Callable[[list[str]], int], *words: object) -> str:
        capsys.readouterr()
        assert main([str(word) for word in words]) == 2
        [line] = without_progress(capsys.readouterr().err)
        return line

    return line_of


@pytest.fixture
def real_data() -> Path:
    """The folder of real scenes that SNERG_DATA names."""
    folder = os.environ.get("SNERG_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("SNERG_DATA names no folder of real scenes")
    return Path(folder)


@pytest.fixture(scope="session")
def procedural_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The procedural scene, 12 + 2 views of 48 x 48 pixels, in Blender layout."""
    from tools.procedural import write_procedural_scene

    return write_procedural_scene(tmp_path_factory.mktemp("procedural"), size=48, views=12, subpixels=2)


@pytest.fixture(scope="session")
def scene(procedural_path: Path):
    from training.scenes import load_scene

    return load_scene(procedural_path)


@pytest.fixture(scope="session")
def dataset(scene):
    from training.dataset import make_dataset

    return make_dataset(scene)


@pytest.fixture(scope="session")
def shapes():
    return shapes_pack()


@pytest.fixture(scope="session")
def shapes_folder(shapes, tmp_path_factory) -> Path:
    """That pack on disk, for whoever only reads it."""
    return written(tmp_path_factory.mktemp("packs") / "shapes", shapes)


@pytest.fixture(scope="session")
def ndc_shapes():
    return shapes_pack(ndc=True)


@pytest.fixture(scope="session")
def surroundings():
    return surroundings_pack()
