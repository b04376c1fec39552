"""Photographs to pictures through the real commands, on a tiny scene; and what each command says of bad input."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from baker.baking import culling
from baker.baking.config import BakeConfig
from baker.baking.passes import COMPACT
from baker.commands.bake import main as snerg_bake
from baker.commands.evaluate import main as snerg_eval
from baker.commands.make import main as snerg_make
from baker.commands.pack import main as snerg_pack
from scenepack import load_pack
from scenepack.blocks import dense_from_pack
from scenepack.codecs.quantisation import steps_of
from training.commands.train import main as snerg_train
from viewer.commands.bench import main as snerg_bench
from viewer.commands.render import main as snerg_render
from viewer.commands.view import main as snerg_view

UNTUNED = ["--quality", "draft"]  # where it does not matter how good the pack is
TRAINING = ["--preset", "quick", "--steps", "200"]


@pytest.fixture(scope="module")
def scene(procedural_path: Path) -> Path:
    return procedural_path


@pytest.fixture(scope="module")
def made(scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What snerg-make leaves: run/ and pack/."""
    out = tmp_path_factory.mktemp("made") / "out"
    assert snerg_make([str(scene), "--out", str(out), *TRAINING, "--resolution", "40", "--no-view"]) == 0
    return out


def test_photographs_become_a_pack_whose_pictures_are_near_the_photographs(made, scene, tmp_path, capsys):
    scores = {}
    for subject in ("run", "pack"):
        report = tmp_path / f"{subject}.json"
        assert snerg_eval([str(made / subject), "--scene", str(scene), "--json", str(report)]) == 0
        scores[subject] = json.loads(report.read_text())
    assert scores["pack"]["width"] == 48 and len(scores["pack"]["views"]) >= 2
    assert scores["run"]["psnr"] > 19 and scores["pack"]["psnr"] > 18
    assert abs(scores["run"]["psnr"] - scores["pack"]["psnr"]) < 1.5, "little is lost in baking"
    capsys.readouterr()
    assert snerg_eval([str(made / "pack"), "--scene", str(scene), "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == scores["pack"], "and nothing but the figures where they go to stdout"


def test_the_pack_is_sound_and_says_where_it_comes_from(made: Path, scene: Path) -> None:
    pack = load_pack(made / "pack")
    assert pack.metadata["provenance"]["scene"] == str(scene.resolve())
    cameras = pack.metadata["cameras"]
    assert sum(camera["split"] == "train" for camera in cameras) == 12
    assert pack.block_size == 30 and pack.view_mlp is not None
    assert pack.metadata["provenance"]["fine_tuning"]["quality"] == BakeConfig().quality == "full"
    assert snerg_pack(["check", str(made / "pack")]) == 0


@pytest.mark.slow
def test_the_same_line_again_goes_on_instead_of_starting_over(made, scene, tmp_path, capsys):
    out = tmp_path / "out"
    shutil.copytree(made / "run", out / "run")
    run = out / "run"
    checkpoints = {path.name: path.read_bytes() for path in (run / "checkpoints").iterdir()}
    journal = (run / "metrics.jsonl").read_bytes()
    started = json.loads((run / "config.json").read_text())["provenance"]["started"]
    line = [str(scene), "--out", str(out), "--resolution", "40", *UNTUNED, "--no-view", "--codec", "webp", *TRAINING]

    assert snerg_make(line) == 0
    assert "keeps its own settings" not in capsys.readouterr().err
    assert list((out / "pack").glob("rgba_*.webp")) and not list((out / "pack").glob("*_000.png"))
    assert load_pack(out / "pack").grid_size[0] <= 60, "40 in whole macroblocks: it is baked again, as this line says"
    assert (run / "metrics.jsonl").read_bytes() == journal, "not one step was taken again"
    assert {path.name: path.read_bytes() for path in (run / "checkpoints").iterdir()} == checkpoints

    assert snerg_make([*line[:-1], "220", "--seed", "7"]) == 0
    assert "keeps its own settings" in capsys.readouterr().err
    after = (run / "metrics.jsonl").read_bytes()
    assert after.startswith(journal), "what was done is kept"
    taken = [json.loads(row) for row in after[len(journal) :].splitlines()]
    assert taken and all(200 < row["step"] <= 220 for row in taken), "and training continues from there"
    assert (run / "checkpoints" / "step_00000200.safetensors").read_bytes() == checkpoints["step_00000200.safetensors"]
    assert json.loads((run / "config.json").read_text())["provenance"]["started"] == started
    assert load_pack(out / "pack").metadata["provenance"]["steps"] == 220


@pytest.mark.slow
def test_a_box_can_be_baked_alone(made: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    line = [str(made / "run"), "--out", str(tmp_path / "pack"), "--resolution", "60"]
    box = np.array([[-0.6, -0.5, -0.3], [0.6, 0.5, 0.4]])
    text = ",".join(map(str, box.ravel()))
    assert snerg_bake([*line, "--aabb", text, "--quality", "compact"]) == 0
    pack = load_pack(tmp_path / "pack")
    assert pack.voxel_size == pytest.approx(1.2 / 60), "as many voxels along the longest side of the box"
    assert pack.metadata["provenance"]["aabb"] == pytest.approx(box.ravel())
    tuned = pack.metadata["provenance"]["fine_tuning"]
    assert tuned["quality"] == "compact"
    assert tuned["train_psnr_after"] > tuned["train_psnr_before"] - 0.6, "coarser steps cost little"
    assert steps_of(pack.atlases) == COMPACT
    z, y, x = np.nonzero(dense_from_pack(pack)[0][..., 3])
    content = (np.stack([x, y, z], -1) + 0.5) * pack.voxel_size + pack.min_xyz
    places = content @ pack.worldspace_T_opengl[:3, :3].T
    assert np.all(places >= box[0] - pack.voxel_size) and np.all(places <= box[1] + pack.voxel_size), "and no more"
    assert np.all(places.min(0) < box[0] + 0.25) and np.all(places.max(0) > box[1] - 0.25)
    assert "nothing was trained in this box" in refused(snerg_bake, *line, "--aabb", "2,-1,-1,3,1,1")
    assert "the box is empty" in refused(snerg_bake, *line, "--aabb", "1,2,3,0,5,6")


def test_a_view_can_be_rendered(made: Path, scene: Path, tmp_path: Path) -> None:
    picture = tmp_path / "view.png"
    line = [str(made / "pack"), "--scene", str(scene), "--split", "test", "--index", "0", "--out", str(picture)]
    assert snerg_render(line) == 0
    with Image.open(picture) as opened:
        assert opened.size == (48, 48) and np.asarray(opened.convert("L")).std() > 10


@pytest.mark.parametrize("there", [False, True])
def test_a_bad_scene_gives_one_line_from_every_command_that_reads_scenes(there, made, scene, tmp_path, refused):
    bad = tmp_path / "bad"
    if there:
        shutil.copytree(scene, bad)
        cut_short(bad / "train" / "r_3.png")
    out = str(tmp_path / "out")
    lines = [
        refused(snerg_train, bad, "--out", out, "--preset", "tiny"),
        refused(snerg_make, bad, "--out", out, "--preset", "tiny"),
        refused(snerg_eval, made / "pack", "--scene", bad, "--split", "train"),
    ]
    for line in lines:
        assert str(bad) in line and ("r_3.png" if there else "no such") in line, line
    assert not (tmp_path / "out" / "pack").exists()


def cut_short(file: Path) -> None:
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])


@pytest.mark.parametrize("there", [False, True])
def test_a_bad_pack_gives_one_line_from_every_command_that_reads_packs(there, made, scene, tmp_path, refused):
    bad = tmp_path / "bad"
    if there:
        shutil.copytree(made / "pack", bad)
        cut_short(bad / "rgba_000.png")
    picture = str(tmp_path / "x.png")
    for command, arguments in (
        (snerg_pack, ["info", str(bad)]),
        (snerg_pack, ["check", str(bad)]),
        (snerg_eval, [str(bad), "--scene", str(scene)]),
        (snerg_render, [str(bad), "--out", picture, "--orbit", "1"]),
        (snerg_bench, [str(bad)]),
        (snerg_view, [str(bad)]),
    ):
        line = refused(command, *arguments)
        assert str(bad) in line, line
    assert not Path(picture).exists()


def test_a_folder_that_is_no_run_cannot_be_baked(tmp_path: Path, scene: Path, refused: Callable[..., str]) -> None:
    assert "no such run" in refused(snerg_bake, tmp_path / "none", "--out", tmp_path / "pack")
    assert "not a run" in refused(snerg_bake, scene, "--out", tmp_path / "pack")
    assert not (tmp_path / "pack").exists()


@pytest.mark.slow
def test_a_run_that_is_no_deferred_model_cannot_be_baked_and_says_so(scene, tmp_path, refused):
    small = "--steps 2 --batch-size 32 --nerf.depth 1 --nerf.width 8 --nerf.coarse-samples 4 --nerf.fine-samples 4"
    line = [str(scene), "--out", str(tmp_path / "run"), "--preset", "jaxnerf", "--downscale", "6", *small.split()]
    assert snerg_train([*line, "--nerf.gradient-rays", "0"]) == 0
    line = refused(snerg_bake, tmp_path / "run", "--out", tmp_path / "pack")
    assert "cannot be baked" in line and str(tmp_path / "run") in line
    assert not (tmp_path / "pack").exists()


@pytest.mark.slow
def test_a_field_with_nothing_in_it_cannot_be_baked(made, tmp_path, refused, monkeypatch):
    monkeypatch.setattr(culling, "TAU_ALPHA", 1.0)  # fainter than this is all
    line = refused(snerg_bake, made / "run", "--out", tmp_path / "pack", "--resolution", "40")
    assert "contains nothing" in line and str(made / "run") in line
    assert not (tmp_path / "pack").exists()


@pytest.mark.slow
def test_a_disk_without_room_costs_one_line_and_the_old_pack_stays(made, tmp_path, refused):
    """Files beyond 20 kB are refused by the system, as they are by a full disk: of the bake's work, or of the pack."""
    resource = pytest.importorskip("resource")
    pack = Path(shutil.copytree(made / "pack", tmp_path / "pack"))
    words = [str(made / "run"), "--out", str(pack), "--resolution", "60", *UNTUNED]
    before = {path.name: path.read_bytes() for path in pack.iterdir()}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        line = refused(snerg_bake, *words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert str(tmp_path) in line and "File too large" in line
    assert {path.name: path.read_bytes() for path in pack.iterdir()} == before
    assert snerg_bake(words) == 0, "with room it goes on"
    assert [path.name for path in tmp_path.iterdir()] == ["pack"]
