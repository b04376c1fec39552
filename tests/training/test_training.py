"""Runs: resumed, interrupted, damaged, diverged; the command around them; checkpoints that do not fit; and presets."""

import dataclasses
import errno
import json
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import jax.numpy as jnp
import numpy as np
import pytest

from baker.commands.make import main as snerg_make
from console import Notice, UserError
from console.atomic import locked_folder
from console.progress import Progress
from console.progress_protocol import PROGRESS, read_report
from tests.compiling import as_users_have_it
from tests.scenepack.helpers import edit_json
from tests.stored_runs import SCENE, STORED
from training.checkpoints import from_arrays, read_newest_checkpoint, to_arrays, write_checkpoint
from training.commands.train import main
from training.config import PRESETS as CONFIGS
from training.config import TINY, from_json
from training.loop import train
from training.multires.config import MultiresConfig
from training.multires.jax_engine import JaxEngine
from training.nerf.method import NerfMethod
from training.recorder import Recorder, read_metrics
from training.run import load_run, read_description
from training.scenes.presets import PRESETS, BakeablePreset, PresetName, voxels_for
from training.speed import whole_runs


@pytest.fixture(scope="module", autouse=True)
def _compiled_as_for_users() -> Iterator[None]:
    """Runs repeat to the last bit, with the programs that users have."""
    with as_users_have_it():
        yield


def losses(run: Path) -> dict[int, float]:
    return {r["step"]: r["loss"] for r in read_metrics(run / "metrics.jsonl") if "loss" in r}


# compiles and steps as fast as can be
NERF = dataclasses.replace(TINY.nerf, depth=1, width=8, coarse_samples=4, fine_samples=4, warmup_steps=2)
FEATURES = MultiresConfig(resolutions=(12,), occupancy=16, samples_per_step=1024, steps_across=(16,), steps_from=())
MINUTE = dataclasses.replace(
    TINY, steps=12, batch_size=32, log_every=1, checkpoint_every=4, nerf=NERF, multires=FEATURES
)


@pytest.fixture(scope="module")
def unbroken(procedural_path: Path, tmp_path_factory) -> Path:
    """A finished run of MINUTE."""
    out = tmp_path_factory.mktemp("runs") / "unbroken"
    train(procedural_path, out, MINUTE)
    return out


def test_a_run_holds_config_checkpoints_metrics_and_a_validation_picture(unbroken: Path, procedural_path: Path):
    config = json.loads((unbroken / "config.json").read_text())
    assert config["config"]["batch_size"] == 32 and config["scene_options"]["downscale"] == 1
    assert config["scene"] == str(procedural_path.resolve()) and "jax" in config["provenance"]
    kept = {path.name for path in (unbroken / "checkpoints").iterdir()}
    assert kept == {"step_00000008.safetensors", "step_00000012.safetensors"}
    assert (unbroken / "validation" / "step_00000012.png").is_file()
    records = read_metrics(unbroken / "metrics.jsonl")
    assert [r["step"] for r in records] == [*range(1, 13), 12] and "validation_psnr" in records[-1]


def test_a_run_stopped_by_ctrl_c_and_resumed_repeats_the_unbroken_one(unbroken, procedural_path, tmp_path, monkeypatch):
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
    run = train(procedural_path, out, MINUTE, resume=read_description(out))
    report = read_report(tmp_path / "progress.json")
    assert report is not None and (report.begun, report.done, report.total) == (7, 12, 12)  # its place in the whole
    assert run.step == 12 and losses(out) == losses(unbroken)
    np.testing.assert_equal(to_arrays(run.state), to_arrays(load_run(unbroken).state))


@pytest.mark.slow
def test_a_killed_run_goes_back_to_its_checkpoint_and_repeats_what_was_lost(unbroken, procedural_path, tmp_path):
    killed = Path(shutil.copytree(unbroken, tmp_path / "killed"))
    (killed / "checkpoints" / "step_00000012.safetensors").unlink()
    with open(killed / "metrics.jsonl", "a") as journal:
        journal.write('{"step": 13, "los')  # cut off amid a line
    train(procedural_path, killed, MINUTE, resume=read_description(killed))
    assert losses(killed) == losses(unbroken)


@pytest.mark.slow
def test_divergence_stops_with_the_last_good_checkpoint_kept(procedural_path: Path, tmp_path: Path):
    nerf = dataclasses.replace(NERF, first_rate=1e30, last_rate=1e30, warmup_steps=0)
    wild = dataclasses.replace(MINUTE, checkpoint_every=1, log_every=3, nerf=nerf)
    with pytest.raises(UserError, match=r"diverged at step .* lower learning rate"):
        train(procedural_path, tmp_path / "run", wild)
    if (tmp_path / "run" / "checkpoints").exists():
        assert not any(np.isnan(a).any() for a in to_arrays(load_run(tmp_path / "run").state).values())


@pytest.mark.slow
def test_a_full_disk_stops_training_with_a_plain_line(procedural_path: Path, tmp_path: Path, monkeypatch):
    def full(path, data):
        if path.suffix == ".safetensors":
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("training.checkpoints.write_file", full)
    with pytest.raises(UserError, match="disk is full"):
        train(procedural_path, tmp_path / "run", MINUTE)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["nerf", "multires"])
def test_a_run_that_time_ends_ends_with_the_last_learning_rate(procedural_path, tmp_path, monkeypatch, method):
    monkeypatch.setattr(Recorder, "seconds", property(lambda recorder: 5.0 * recorder.run.step))  # a step takes 5 s
    config = dataclasses.replace(MINUTE, method=method, engine="jax", steps=100_000, minutes=1.0)
    moved = []
    if method == "multires":
        step = JaxEngine.step
        monkeypatch.setattr(JaxEngine, "step", lambda *words: moved.append(words[-1]) or step(*words))
    shown, update = [], Progress.update

    def see(bar, done, *args, **named):
        if bar.title == "training":
            shown.append(done)
        update(bar, done, *args, **named)

    monkeypatch.setattr(Progress, "update", see)
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
    resumed = train(procedural_path, run.path, more, resume=run.description)
    records = [r for r in read_metrics(run.path / "metrics.jsonl") if "loss" in r and r["step"] > run.step]
    assert resumed.step > run.step and 0.4 < records[0]["progress"] < 0.7 and records[-1]["progress"] > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("there", [True, False])
def test_a_run_that_somebody_trains_into_is_left_alone(there: bool, unbroken, procedural_path, tmp_path, refused):
    run = tmp_path / "deep" / "run"
    if there:
        shutil.copytree(unbroken, run)
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    words = [str(procedural_path), "--out", str(run), *(["--resume"] if there else ["--preset", "tiny"])]
    with locked_folder(run, "training into this run"):
        assert "another process is training into this run" in refused(main, *words)
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    assert (tmp_path / "deep").exists() == there, "folders that are left empty are taken away"
    if there:
        assert main(words) == 0, "nobody holds it any more"


def test_neither_a_run_nor_a_folder_of_other_files_is_overwritten(unbroken, procedural_path, tmp_path, refused):
    line = refused(main, procedural_path, "--out", unbroken, "--preset", "tiny")
    assert line.startswith("snerg-train: ") and "exists already" in line and "--resume" in line
    (tmp_path / "letter.txt").write_text("dear")
    assert "another --out" in refused(main, procedural_path, "--out", tmp_path, "--preset", "tiny")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--nerf.width", "9"], "--nerf.width"),
        (["--seed", "5", "--batch-size", "64"], "--batch-size, --seed"),
        (["--downscale", "2"], "--downscale"),
    ],
)
def test_a_resumed_run_keeps_its_settings(unbroken: Path, procedural_path: Path, refused, options, words):
    assert words in refused(main, procedural_path, "--out", unbroken, "--resume", *options)


@pytest.mark.slow
def test_a_run_whose_photographs_are_gone_says_so(unbroken: Path, tmp_path: Path):
    moved = Path(shutil.copytree(unbroken, tmp_path / "moved"))
    edit_json(moved / "config.json", lambda document: document.update(scene=str(tmp_path / "gone")))
    with pytest.raises(UserError, match=r"gone: no such folder \(found .*/gone\).*--scene FOLDER"):
        load_run(moved)
    assert load_run(moved, scene_path=json.loads((unbroken / "config.json").read_text())["scene"]).step


ARRAYS = {"weight": np.arange(12, dtype=np.float32).reshape(3, 4), "count": np.array(7, np.int32)}


@pytest.mark.parametrize("damage", ["cut", "flip", "empty"])
def test_a_damaged_checkpoint_is_passed_over_with_a_warning(tmp_path: Path, damage: str):
    write_checkpoint(tmp_path, 10, ARRAYS)
    path = write_checkpoint(tmp_path, 20, ARRAYS)
    data = bytearray(path.read_bytes())
    if damage == "flip":
        data[-3] ^= 0x40
    path.write_bytes({"cut": data[: len(data) // 2], "flip": data, "empty": b""}[damage])
    with pytest.warns(Notice, match=r"step_00000020.*damaged.*before"):
        step, _ = read_newest_checkpoint(tmp_path)
    assert step == 10


def test_no_checkpoint_and_no_readable_one_are_errors_with_a_remedy(tmp_path: Path):
    with pytest.raises(UserError, match="no checkpoint"):
        read_newest_checkpoint(tmp_path)
    write_checkpoint(tmp_path, 10, ARRAYS).write_bytes(b"nonsense")
    with pytest.warns(Notice), pytest.raises(UserError, match="can be read"):
        read_newest_checkpoint(tmp_path)


def test_arrays_of_another_shape_or_a_missing_one_are_refused():
    template = {"a": jnp.ones((2, 2))}
    with pytest.raises(UserError, match=r'"a" does not fit.*\[2, 2\].*\[3\]'):
        from_arrays(template, {"a": np.ones(3, np.float32)})
    with pytest.raises(UserError, match=r'"a" does not fit.*found none'):
        from_arrays(template, {})


@pytest.mark.parametrize("name", ["metrics.jsonl", "curves.png", "validation/latest.png", "config.json"])
@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_link_or_a_pipe_in_the_place_of_a_file_is_refused(name, kind, tmp_path, refused):
    run, mine = Path(shutil.copytree(STORED / "multires", tmp_path / "run")), tmp_path / "mine.txt"
    mine.write_bytes((run / name).read_bytes() if name == "config.json" else b"mine")
    before = mine.read_bytes()
    file = run / name
    file.parent.mkdir(exist_ok=True)
    file.unlink(missing_ok=True)
    file.symlink_to(mine) if kind == "link" else os.mkfifo(file)
    assert file.name in refused(main, SCENE, "--out", run, "--resume") or name == "config.json"
    assert mine.read_bytes() == before


def test_every_preset_has_settings_and_snerg_make_offers_those_that_a_pack_can_hold() -> None:
    assert set(get_args(PresetName)) == {name for name, preset in PRESETS.items() if preset.about} == set(CONFIGS)
    deferred = {name for name, config in CONFIGS.items() if config.nerf.view in ("deferred", "none")}
    assert set(get_args(BakeablePreset)) == deferred | {n for n, c in CONFIGS.items() if c.method == "multires"}


@pytest.mark.parametrize(("command", "kind"), [(snerg_make, BakeablePreset), (main, PresetName)])
def test_help_explains_every_preset(command, kind, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    assert command(["--help"]) == 0
    help_text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for name in get_args(kind):
        assert f"{name} ({PRESETS[name].about})" in help_text


def test_packs_are_about_as_fine_as_photographs_and_those_of_unbounded_scenes_four_times_as_fine() -> None:
    objects = [voxels_for(pixels, "object") for pixels in (200, 400, 504, 640, 800, 4000)]
    assert objects == [512, 512, 630, 800, 1000, 1000]
    assert [voxels_for(pixels, "forward") for pixels in (252, 504, 1008)] == [512, 756, 1000]
    assert [voxels_for(pixels, "unbounded") for pixels in (64, 128, 240, 256)] == [512, 640, 1000, 1000]


def test_larger_photographs_take_more_of_both_until_the_field_is_as_fine_as_it_gets() -> None:
    runs = whole_runs([100, 250, 800, 1600], "object")["quick"]
    for key in ("samples", "disk"):
        assert runs[100][key] <= runs[250][key] < runs[800][key] == runs[1600][key]
    assert runs[100]["disk"] < runs[250]["disk"]
    forward = whole_runs([504, 1008], "forward")["normal"]
    assert forward[504]["samples"] == 12_000 * 32_768 and forward[1008]["samples"] > 3 * forward[504]["samples"]
    assert forward[504]["disk"] > 1.5 * whole_runs([504], "object")["normal"][504]["disk"]
    assert whole_runs([100], "unbounded")["quick"][100]["disk"] > 1e9


@pytest.mark.parametrize(
    ("name", "value"),
    [("batch_size", -1), ("log_every", 0), ("seed", 10**20), ("steps", -5), ("minutes", float("nan")), ("nerf.width", 0),
     ("multires.occupancy", 0), ("multires.view_octaves", -1), ("multires.steps_from", [0.1, float("nan")]),
     ("nerf.first_rate", -1.0), ("nerf.last_rate", 0.0), ("sparsity_scale", 0), ("checkpoint_every", 0), ("nerf.depth", 2.5),
     ("method", "magic")],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused_by_name(name: str, value: object) -> None:
    document = dataclasses.asdict(TINY)
    inner = document
    for part in name.split(".")[:-1]:
        inner = inner[part]
    inner[name.split(".")[-1]] = value
    with pytest.raises(UserError, match=name.split(".")[-1].replace("_", ".")):
        from_json(type(TINY), document, "config.json")
