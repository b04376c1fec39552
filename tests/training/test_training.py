"""Runs: resumed, interrupted, damaged, diverged; and the command around them."""

from __future__ import annotations

import builtins
import dataclasses
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from console import Notice, UserError
from console.progress import Progress
from console.progress_protocol import PROGRESS, read_report
from tests.compiling import as_users_have_it
from tests.told import told
from training.checkpoints import to_arrays
from training.commands.train import main
from training.config import PRESETS, TINY, TrainConfig, from_json
from training.loop import train
from training.multires.config import MultiresConfig
from training.multires.jax_engine import JaxEngine
from training.nerf.method import NerfMethod
from training.recorder import MetricsLog, Recorder, read_metrics
from training.run import load_run, start_run
from training.scenes import SceneOptions

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", autouse=True)
def _compiled_as_for_users() -> Iterator[None]:
    """Runs repeat to the last bit, with the programs that users have."""
    with as_users_have_it():
        yield


def losses(run: Path) -> dict[int, float]:
    return {r["step"]: r["loss"] for r in read_metrics(run / "metrics.jsonl") if "loss" in r}


# compiles and steps as fast as can be
MINUTE = dataclasses.replace(
    TINY,
    steps=12,
    batch_size=32,
    log_every=1,
    checkpoint_every=4,
    nerf=dataclasses.replace(TINY.nerf, depth=1, width=8, coarse_samples=4, fine_samples=4, warmup_steps=2),
)


@pytest.fixture(scope="module")
def unbroken(procedural_path: Path, tmp_path_factory) -> Path:
    """A finished run of minute_config."""
    out = tmp_path_factory.mktemp("runs") / "unbroken"
    train(procedural_path, out, MINUTE)
    return out


def test_a_run_holds_config_checkpoints_metrics_and_a_validation_picture(unbroken: Path, procedural_path: Path):
    config = json.loads((unbroken / "config.json").read_text())
    assert config["config"]["batch_size"] == 32 and config["scene_options"]["downscale"] == 1
    assert config["scene"] == str(procedural_path.resolve()) and "jax" in config["provenance"]
    assert [p.name for p in sorted((unbroken / "checkpoints").iterdir())] == [
        "step_00000008.safetensors",
        "step_00000012.safetensors",
    ]
    assert (unbroken / "validation" / "step_00000012.png").is_file()
    records = read_metrics(unbroken / "metrics.jsonl")
    assert [r["step"] for r in records] == [*range(1, 13), 12] and "validation_psnr" in records[-1]


def test_a_run_stopped_by_ctrl_c_and_resumed_repeats_the_unbroken_one_exactly(
    unbroken: Path, procedural_path: Path, tmp_path: Path, monkeypatch
):
    out, step_of = tmp_path / "broken", NerfMethod.step

    def step_and_interrupt(self, state, step, progress):
        if step == 6:
            os.kill(os.getpid(), signal.SIGINT)
        return step_of(self, state, step, progress)

    monkeypatch.setattr(NerfMethod, "step", step_and_interrupt)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt, match=r"saved at step 7; continue with: snerg-train .* --resume"):
        train(procedural_path, out, MINUTE)
    assert signal.getsignal(signal.SIGINT) is before
    monkeypatch.undo()
    monkeypatch.setenv(PROGRESS, str(tmp_path / "progress.json"))
    run = train(procedural_path, out, MINUTE, resume=True)
    report = read_report(tmp_path / "progress.json")
    assert report is not None and (report.begun, report.done, report.total) == (7, 12, 12)  # its place in the whole
    assert run.step == 12 and losses(out) == losses(unbroken)
    ours, theirs = to_arrays(run.state), to_arrays(load_run(unbroken).state)
    for name in theirs:
        np.testing.assert_array_equal(ours[name], theirs[name])


def test_a_killed_run_goes_back_to_its_checkpoint_and_repeats_what_was_lost(
    unbroken: Path, procedural_path: Path, tmp_path: Path
):
    killed = Path(shutil.copytree(unbroken, tmp_path / "killed"))
    (killed / "checkpoints" / "step_00000012.safetensors").unlink()
    with open(killed / "metrics.jsonl", "a") as journal:
        journal.write('{"step": 13, "los')  # cut off amid a line
    train(procedural_path, killed, MINUTE, resume=True)
    assert losses(killed) == losses(unbroken)


def test_a_run_killed_between_checkpoint_and_validation_makes_up_for_it(
    unbroken: Path, procedural_path: Path, tmp_path: Path
):
    killed = Path(shutil.copytree(unbroken, tmp_path / "killed"))
    lines = (killed / "metrics.jsonl").read_text().splitlines(keepends=True)
    [lost] = [line for line in lines if "validation_psnr" in line]
    (killed / "metrics.jsonl").write_text("".join(line for line in lines if line != lost))
    shutil.rmtree(killed / "validation")
    for _ in range(2):  # once, however often it is resumed
        train(procedural_path, killed, MINUTE, resume=True)
        [again] = [record for record in read_metrics(killed / "metrics.jsonl") if "validation_psnr" in record]
        assert (again["step"], again["validation_psnr"]) == (12, json.loads(lost)["validation_psnr"])
    assert (killed / "validation" / "step_00000012.png").is_file()


def test_a_run_killed_before_it_had_begun_can_be_started(procedural_path: Path, tmp_path: Path, monkeypatch):
    run = tmp_path / "run"
    run.mkdir()
    (run / ".config.json.new-99999999-0123abcd").write_text("{")
    started = start_run(run, procedural_path, MINUTE, SceneOptions())
    assert started.step == 0 and [file.name for file in run.iterdir()] == ["config.json"]


def test_a_damaged_newest_checkpoint_costs_a_warning_and_some_steps(unbroken: Path, tmp_path: Path):
    damaged = Path(shutil.copytree(unbroken, tmp_path / "damaged"))
    path = damaged / "checkpoints" / "step_00000012.safetensors"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.warns(Notice, match="damaged"):
        assert load_run(damaged).step == 8


def test_a_loaded_run_renders_queries_and_knows_its_scene(unbroken: Path):
    run = load_run(unbroken)
    assert (
        run.step == 12
        and run.config == dataclasses.replace(MINUTE, engine="jax")
        and len(run.scene.splits["train"]) == 12
    )
    rays = run.dataset.view_rays(run.scene.splits["test"][0].camera)
    out = run.method.render(run.state, rays)
    assert out.rgb.shape == (48 * 48, 3) and float(out.rgb.min()) >= 0 and float(out.rgb.max()) <= 1


def test_divergence_stops_with_the_last_good_checkpoint_kept(procedural_path: Path, tmp_path: Path):
    wild = dataclasses.replace(
        MINUTE,
        checkpoint_every=1,
        log_every=3,
        nerf=dataclasses.replace(MINUTE.nerf, first_rate=1e30, last_rate=1e30, warmup_steps=0),
    )
    with pytest.raises(UserError, match=r"diverged at step .* lower learning rate"):
        train(procedural_path, tmp_path / "run", wild)
    if (tmp_path / "run" / "checkpoints").exists():
        for arrays in [load_run(tmp_path / "run").state]:
            assert all(not np.isnan(a).any() for a in to_arrays(arrays).values())


def test_a_full_disk_stops_training_with_a_plain_line(procedural_path: Path, tmp_path: Path, monkeypatch, capsys):
    def full(path, data):
        if path.suffix == ".safetensors":
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("training.checkpoints.write_file", full)
    with pytest.raises(UserError, match="disk is full"):
        train(procedural_path, tmp_path / "run", MINUTE)


def test_time_can_be_limited(procedural_path: Path, tmp_path: Path):
    run = train(procedural_path, tmp_path / "run", dataclasses.replace(MINUTE, steps=100_000, minutes=1e-9))
    assert run.step == 1 and load_run(tmp_path / "run").step == 1


@pytest.mark.parametrize("method", ["nerf", "multires"])
def test_a_run_that_time_ends_ends_with_the_last_learning_rate(
    procedural_path: Path, tmp_path: Path, monkeypatch, method: str
):
    monkeypatch.setattr(Recorder, "seconds", property(lambda recorder: 5.0 * recorder.run.step))  # a step takes 5 s
    multires = MultiresConfig(resolutions=(12,), occupancy=16, samples_per_step=1024, steps_across=(16, 16, 16))
    config = dataclasses.replace(MINUTE, method=method, engine="jax", steps=100_000, minutes=1.0, multires=multires)
    moved = []
    if method == "multires":
        step = JaxEngine.step
        monkeypatch.setattr(JaxEngine, "step", lambda *words: moved.append(words[-1]) or step(*words))
    shown, update = [], Progress.update
    monkeypatch.setattr(Progress, "update", lambda bar, done, **words: shown.append(done) or update(bar, done, **words))
    run = train(procedural_path, tmp_path / "run", config)
    assert shown == sorted(shown) and shown[-1] > 0.9 * config.steps  # the share of the minute
    records = [r for r in read_metrics(run.path / "metrics.jsonl") if "loss" in r]
    shares = [r["progress"] for r in records]
    assert shares == sorted(shares) and shares[0] < 0.2 and 0.9 < shares[-1] <= 1.0 and run.step == 12
    if method == "multires":
        assert moved == shares
    else:
        last = config.nerf.last_rate * (config.nerf.first_rate / config.nerf.last_rate) ** (1 - shares[-1])
        assert records[-1]["learning_rate"] == pytest.approx(last, rel=1e-4)
    more = dataclasses.replace(run.config, minutes=2.0)
    resumed = train(procedural_path, run.path, more, resume=True)
    records = [r for r in read_metrics(run.path / "metrics.jsonl") if "loss" in r and r["step"] > run.step]
    assert resumed.step > run.step and 0.4 < records[0]["progress"] < 0.7 and records[-1]["progress"] > 0.9


def test_seconds_of_training_go_on_counting_after_a_resume(tmp_path: Path):
    path = tmp_path / "metrics.jsonl"
    path.write_text('{"step": 1, "seconds": 2.5}\n{"step": 2, "seconds": 5.0}\n{"step": 3, "seconds": 7.5}\n')
    assert MetricsLog(path, 2).seconds == 5.0
    assert [r["step"] for r in read_metrics(path)] == [1, 2]


# --- the command
# -------------------------------------------------------------------------------------------------------


def one_line(capsys) -> str:
    [line] = told(capsys.readouterr().err)
    assert line.startswith("snerg-train: "), line
    return line


ROOT = Path(__file__).parents[2]
HOLDING = (
    "import sys; from pathlib import Path; from training.lock import only_one_trains\n"
    "with only_one_trains(Path(sys.argv[1])):\n    print('held', flush=True); sys.stdin.read()"
)


@pytest.mark.parametrize("there", [True, False])
def test_two_processes_do_not_train_into_one_run(there: bool, unbroken: Path, procedural_path: Path, tmp_path, capsys):
    run = tmp_path / "deep" / "run"
    if there:
        shutil.copytree(unbroken, run)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    words = [str(procedural_path), "--out", str(run), *(["--resume"] if there else ["--preset", "tiny"])]
    child = subprocess.Popen(
        [sys.executable, "-c", HOLDING, str(run)], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert child.stdout is not None and child.stdout.readline() == "held\n"
        assert main(words) == 2
        assert "another process is training into this run" in one_line(capsys)
    finally:
        child.communicate(timeout=60)
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    assert (tmp_path / "deep").exists() == there, "folders that are left empty are taken away"
    if there:
        assert main(words) == 0, "the lock has ended with its process"


def test_an_existing_run_is_not_overwritten(unbroken: Path, procedural_path: Path, capsys):
    assert main([str(procedural_path), "--out", str(unbroken), "--preset", "tiny"]) == 2
    assert "exists already" in (line := one_line(capsys)) and "--resume" in line


def test_a_folder_that_is_no_run_is_not_overwritten_either(procedural_path: Path, tmp_path: Path, capsys):
    (tmp_path / "letter.txt").write_text("dear")
    assert main([str(procedural_path), "--out", str(tmp_path), "--preset", "tiny"]) == 2
    assert "another --out" in one_line(capsys)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--nerf.width", "9"], "--nerf.width"),
        (["--seed", "5", "--batch-size", "64"], "--batch-size, --seed"),
        (["--downscale", "2"], "--downscale"),
    ],
)
def test_a_resumed_run_keeps_its_settings(unbroken: Path, procedural_path: Path, capsys, options, words):
    assert main([str(procedural_path), "--out", str(unbroken), "--resume", *options]) == 2
    assert words in one_line(capsys)


def test_a_finished_run_can_be_given_more_steps(unbroken: Path, procedural_path: Path, tmp_path: Path, capsys):
    longer = Path(shutil.copytree(unbroken, tmp_path / "longer"))
    assert main([str(procedural_path), "--out", str(longer), "--resume", "--steps", "14"]) == 0
    assert "14 of 14 steps" in capsys.readouterr().out
    assert load_run(longer).step == 14 and load_run(longer).config.steps == 14


def test_a_resumed_runs_description_is_read_once(unbroken: Path, procedural_path: Path, tmp_path: Path, monkeypatch):
    longer = Path(shutil.copytree(unbroken, tmp_path / "longer"))
    read: list[str] = []

    def listening(opener):
        def opened(path, *arguments, **options):
            read.append(Path(path).name if isinstance(path, str | Path) else "")
            return opener(path, *arguments, **options)

        return opened

    monkeypatch.setattr(Path, "open", listening(Path.open))
    monkeypatch.setattr(builtins, "open", listening(builtins.open))
    assert main([str(procedural_path), "--out", str(longer), "--resume", "--steps", "13"]) == 0
    assert read.count("config.json") == 1


@pytest.mark.parametrize("way", ["started", "resumed", "resumed before its first checkpoint", "loaded"])
def test_a_method_that_cannot_be_made_stops_all_processes_together(
    unbroken: Path, procedural_path: Path, tmp_path: Path, monkeypatch, way: str
):
    out, met = tmp_path / "run", []
    if way != "started":
        shutil.copytree(unbroken, out)
    if "before" in way:
        shutil.rmtree(out / "checkpoints")

    @contextmanager
    def together():
        try:
            yield
        except UserError as error:
            met.append(error)
            raise

    def refuse(*arguments):
        raise UserError("cannot be made")

    monkeypatch.setattr("training.run.together", together)
    monkeypatch.setattr("training.run.make_method", refuse)
    with pytest.raises(UserError, match="cannot be made"):
        if way == "loaded":
            load_run(out)
        else:
            train(procedural_path, out, MINUTE, resume=way != "started")
    assert [str(error) for error in met] == ["cannot be made"]


@pytest.mark.parametrize("spoil", ["missing", "no config", "no JSON", "unknown field", "wrong type"])
def test_resuming_what_is_no_run_gets_one_line(unbroken: Path, procedural_path: Path, tmp_path: Path, capsys, spoil):
    out = tmp_path / "run"
    if spoil != "missing":
        shutil.copytree(unbroken, out)
    if spoil == "no config":
        (out / "config.json").unlink()
    if spoil == "no JSON":
        (out / "config.json").write_text("{")
    if spoil in ("unknown field", "wrong type"):
        document = json.loads((out / "config.json").read_text())
        document["config"] = {"colour": 1} if spoil == "unknown field" else 5
        (out / "config.json").write_text(json.dumps(document))
    assert main([str(procedural_path), "--out", str(out), "--resume"]) == 2
    assert str(out) in one_line(capsys)


def test_a_run_whose_photographs_are_gone_says_so(unbroken: Path, tmp_path: Path):
    moved = Path(shutil.copytree(unbroken, tmp_path / "moved"))
    document = json.loads((moved / "config.json").read_text())
    document["scene"] = str(tmp_path / "gone")
    (moved / "config.json").write_text(json.dumps(document))
    with pytest.raises(UserError, match=r"gone: no such folder \(found .*/gone\).*--scene FOLDER"):
        load_run(moved)
    assert load_run(moved, scene_path=json.loads((unbroken / "config.json").read_text())["scene"]).step


def test_bad_scenes_and_presets_end_with_status_2(tmp_path: Path, capsys):
    assert main([str(tmp_path / "absent"), "--out", str(tmp_path / "run")]) == 2
    assert "no such folder" in one_line(capsys)
    assert not (tmp_path / "run").exists()
    assert main([str(tmp_path), "--out", str(tmp_path / "run"), "--preset", "best"]) == 2
    assert "best" in one_line(capsys)


@pytest.mark.parametrize("name", PRESETS)
def test_a_config_goes_through_json_and_back(name: str):
    written = json.loads(json.dumps(dataclasses.asdict(PRESETS[name])))
    assert from_json(TrainConfig, written, "config.json") == PRESETS[name]


def test_a_checkpoint_of_another_version_is_told_in_one_line(unbroken: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(NerfMethod, "restore", lambda self, arrays: arrays["what a later version keeps"])
    with pytest.raises(UserError, match=r"another version of snerg.*what a later version keeps") as caught:
        load_run(unbroken)
    assert "\n" not in str(caught.value)
