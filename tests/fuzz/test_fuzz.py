"""A few hundred spoilt files a run, and all that ever broke: opened, or refused in one line, within limits of memory and time.

`make fuzz` tries more of them. The seed is fixed, so that a failure here comes again; a new one belongs under findings.
"""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.fuzz.child import FINDING, OPENED, REFUSED
from tests.fuzz.recipes import SUBJECTS, Source, findings, write_bases
from tests.fuzz.spellings import trial
from tests.fuzz.workers import Worker

BUDGET = {"packs": 80, "scenes": 50, "settings": 100, "runs": 12}
SEED = 2193


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bases(tmp_path_factory.mktemp("bases"))


@pytest.fixture(scope="module", params=SUBJECTS)
def worker(request: pytest.FixtureRequest, bases: Path) -> Iterator[Worker]:
    with Worker(request.param, bases) as worker:
        yield worker


@pytest.mark.slow
def test_spoilt_files_are_opened_or_refused(worker: Worker, bases: Path) -> None:
    source = Source(worker.subject, bases, SEED)
    broken, kinds = {}, set()
    for number in range(BUDGET[worker.subject]):
        recipe = source.recipe(number)
        outcome = worker.outcome(recipe)
        kinds.add(outcome.kind)
        if outcome.kind == FINDING:
            broken[json.dumps(recipe)] = f"{outcome.key}: {outcome.line}"
    assert not broken
    assert kinds == {OPENED, REFUSED}, "neither is everything refused, nor nothing spoilt"


def test_what_was_found_once_is_not_found_again(worker: Worker) -> None:
    broken = {}
    for recipe in findings():
        if recipe["subject"] == worker.subject and (outcome := worker.outcome(recipe)).kind == FINDING:
            broken[json.dumps(recipe)] = f"{outcome.key}: {outcome.line}"
    assert not broken


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "key"),
    [
        ("pass", ""),
        ("raise UserError('refused', where=path)", ""),
        ("raise RuntimeError('broken')", "RuntimeError"),
        ("error = UserError('x'); error.args = ('long' * 1000,); raise error", "words"),
        ("try:\n bytearray(3 << 30)\nexcept MemoryError:\n raise UserError('cannot be decoded')", "memory"),
        ("import os; os.kill(os.getpid(), 11)", "death SIGSEGV"),
        ("open(path.parents[2] / 'outside', 'w')", "trespass writes"),
        (
            "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM).bind(('127.0.0.1', 0))",
            "trespass socket.bind",
        ),
        ("import warnings; warnings.warn('overflow', RuntimeWarning)", "RuntimeWarning"),
    ],
)
def test_the_fuzzer_sees_what_breaks(code: str, key: str, breaking: Worker) -> None:
    """One that finds nothing proves nothing."""
    recipe = {"subject": "breaking", "base": "code", "steps": [["insert", "code.py", 0, code.encode().hex(), 1]]}
    outcome = breaking.outcome(recipe)
    assert (outcome.kind == FINDING) == bool(key), outcome
    assert outcome.key.startswith(key)
    assert breaking.outcome({**recipe, "steps": []}).kind == OPENED, "it goes on, with another child where one died"


@pytest.fixture(scope="module")
def breaking(bases: Path) -> Iterator[Worker]:
    with Worker("breaking", write_bases(bases, ("breaking",))) as worker:
        yield worker


@pytest.mark.filterwarnings("ignore::console.Notice")
def test_a_scene_has_the_same_rays_however_it_is_written(tmp_path: Path):
    assert {seed: found for seed in range(30) if (found := trial(seed, tmp_path / str(seed)))} == {}
