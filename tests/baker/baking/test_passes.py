"""The passes over a bake's voxels: what each is given, what it leaves to the next, and which of them a preset has."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from baker.baking import bake as baking
from baker.baking import passes
from baker.baking.config import MOST_MACROBLOCKS, UNLIMITED, BakeConfig, BakePreset, Quality
from baker.baking.grid import make_grid
from baker.baking.passes import passes_of, with_views_between
from baker.baking.supersample import SAMPLES, Sampler
from baker.commands.bake import main as snerg_bake
from baker.commands.make import main as snerg_make
from baker.reports.float_pictures import float_pictures
from baker.tuning import fine_tune as tuning
from baker.tuning.fine_tune import shaded_pixels
from console.progress import progress
from scenepack.blocks import block_copy, dense_from_pack
from tests.baker.analytic import ball, culled
from tests.reference_marcher import render_reference
from tests.scenepack.random_packs import BLENDER_FRAME, random_pack
from tests.scenepack.volumes import cube_pack, features_of
from tests.stored_runs import SCENE, STORED
from training.dataset import RayDataset
from training.run import load_run
from viewer.rendering.camera import ViewCamera


@pytest.mark.parametrize("preset", ["snerg", "paper"])
def test_what_tunes_compares_with_photographs_in_the_look_of_the_field(monkeypatch, preset):
    run = load_run(STORED / "multires", scene_path=SCENE)
    dataset, seen = run.dataset, []
    run.state.gains = gains = np.ones((dataset.views, 3), np.float32)
    gains[:, 0] = np.linspace(0.5, 1.5, dataset.views)

    def tune(pack: Any, photographs: RayDataset, *_: Any, **__: Any) -> Any:
        seen.append(photographs)
        raise KeyboardInterrupt  # what comes after does not matter

    monkeypatch.setattr(passes, "fine_tune", tune)
    monkeypatch.setattr(passes, "joint_tune", tune)
    with pytest.raises(KeyboardInterrupt):
        baking.bake(run, BakeConfig(31, preset))
    ids = jnp.arange(0, dataset.count, 7)
    shown = np.asarray(dataset.in_average_look(gains).colours_at(ids))
    assert np.abs(shown - np.asarray(dataset.colours_at(ids))).max() > 0.1
    assert len(seen) == 1 and np.array_equal(np.asarray(seen[0].colours_at(ids)), shown)


def test_sharpened_voxels_of_contracted_space_interpolate_to_less_than_half_the_error(dataset: RayDataset) -> None:
    def wave(place: np.ndarray) -> np.ndarray:
        return 0.5 + 0.4 * np.cos(0.4 * place).prod(axis=0)

    alpha, places, errors = wave(np.mgrid[:28, :28, :28]), np.random.default_rng(0).uniform(1, 26, (3, 4000)), []
    straight = cube_pack(np.rint(255 * alpha[..., None] * [0.5, 0.5, 0.5, 1.0]).astype(np.uint8), 14)
    for pack in (straight, straight.with_metadata(contraction=1.0)):
        with progress("", 1.0, quiet=True) as bar:
            passes.sharpened(passes.Voxels(pack, dataset, BakeConfig()), bar)
        shown = map_coordinates(dense_from_pack(pack)[0][..., 3] / 255, places, order=1)
        errors.append(np.linalg.norm(shown - wave(places)))
    rgba = dense_from_pack(straight)[0].astype(int)  # what both packs share
    assert errors[1] < 0.5 * errors[0] and np.abs(2 * rgba[..., 0] - rgba[..., 3]).mean() < 1.5, "colours as opacity"


def test_scaled_features_say_the_same_to_the_view_mlp(dataset: RayDataset) -> None:
    pack = random_pack(np.random.default_rng(0))
    values = features_of(pack).astype(float)
    with progress("", 1.0, quiet=True) as bar:
        scaled = passes.with_scaled_features(passes.Voxels(pack, dataset, BakeConfig()), bar).pack
    assert scaled.view_mlp is not None and pack.view_mlp is not None
    before, now = pack.view_mlp.weights[0], scaled.view_mlp.weights[0]
    assert features_of(scaled).max() <= 64 and np.array_equal(now[:-4], before[:-4])
    rounding = 0.5 * np.abs(now[-4:]).sum(axis=0) + 1e-3
    assert np.all(np.abs(features_of(scaled) @ now[-4:] - values @ before[-4:]) <= rounding)


def test_a_bake_says_how_it_was_made_and_of_the_papers_nothing_is_emptied(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(passes, "MOST_LOST_PRUNED", 3.0)  # so coarse a grid of mist would keep all
    loaded = load_run(STORED / "multires", scene_path=SCENE)
    ours, papers = (baking.bake(loaded, BakeConfig(31, preset, "draft")) for preset in ("snerg", "paper"))
    made, literal = ours.metadata["provenance"], papers.metadata["provenance"]
    assert (made["preset"], made["quality"], literal["preset"]) == ("snerg", "draft", "paper")
    left = np.count_nonzero(dense_from_pack(ours)[0][..., 3])
    assert made["voxels"]["after"] == left < made["voxels"]["before"] and made["voxels"]["tau_weight"] > 0
    assert made["macroblocks"]["kept"] == np.count_nonzero(ours.occupied)
    assert "voxels" not in literal and "fine_tuning" not in made


def test_photographs_come_first_and_each_has_a_wider_view_midway_to_another(dataset: RayDataset) -> None:
    views, pixels = with_views_between(dataset), 48 * 48
    assert dataset.views < views.views <= 2 * dataset.views and views.count == views.views * pixels
    ids = jnp.arange(0, dataset.count, 97)
    for ours, theirs in zip(views.geometry_at(ids), dataset.geometry_at(ids), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    poses = np.asarray(views.world_T_camera, np.float64)
    given = poses[: dataset.views]
    for pose in poses[dataset.views :]:
        middle = 0.5 * (given[:, None, :, 3] + given[None, :, :, 3])
        i, j = np.unravel_index(np.linalg.norm(middle - pose[:, 3], axis=-1).argmin(), (len(given), len(given)))
        np.testing.assert_allclose(pose[:, 3], middle[i, j], atol=1e-6)
        one, here, other = (Rotation.from_matrix(turn[:, :3]) for turn in (given[i], pose, given[j]))
        apart = [(here.inv() * one).magnitude(), (here.inv() * other).magnitude()]
        assert apart == pytest.approx(2 * [0.5 * (one.inv() * other).magnitude()], abs=1e-4), "turned half of the way"
    corners = pixels * np.array([[0], [views.views - 1]]) + [0, 47, pixels - 48, pixels - 1]
    photograph, between = (np.asarray(views.geometry_at(jnp.asarray(ids)).directions) for ids in corners)
    assert (between @ between.T).min() < (photograph @ photograph.T).min() - 0.1


def test_what_is_rounded_is_the_pack_and_drawn_as_the_reference_draws_it_and_what_is_not_differs() -> None:
    run = load_run(STORED / "nerf", scene_path=SCENE)
    config = BakeConfig(resolution=45, preset="paper", quality="draft")
    pack, floats = baking.bake(run, config), baking.bake_floats(run, config)
    assert floats.bytes == 32 * pack.atlas_rgba[..., 0].size
    values = np.round(255 * floats.values).astype(np.uint8)
    values[values[:, 3] == 0] = 0
    atlas = np.concatenate([pack.atlas_rgba, features_of(pack)], axis=-1)
    for block in map(tuple, np.argwhere(pack.occupied)):
        np.testing.assert_array_equal(block_copy(pack, values[floats.rows], block), block_copy(pack, atlas, block))
    camera = run.scene.splits["test"][0].camera
    drawn = float_pictures(replace(floats, values=values / np.float32(255)), run)
    wanted = render_reference(pack, ViewCamera.from_scene_camera(pack, camera))
    differences = drawn.show(camera, "normal") - wanted.rgb, drawn.show(camera, "alpha") - wanted.alpha
    assert all(np.quantile(np.abs(d), 0.999) < 1 / 255 and np.abs(d).max() < 0.05 for d in differences)
    unrounded = float_pictures(floats, run).show(camera, "normal")
    assert 1e-5 < np.mean(np.abs(unrounded - wanted.rgb)) < 0.05


# snerg-bake --preset paper: what the paper writes (sections 5.3 to 5.5 and 6), setting by setting


@pytest.fixture
def configs(monkeypatch: pytest.MonkeyPatch) -> list[BakeConfig]:
    """How runs would be baked, in place of their bakes."""
    noted: list[BakeConfig] = []

    def bake_to(run: Any, config: BakeConfig, *_: Any, **__: Any) -> None:
        noted.append(replace(config, resolution=config.resolution_of(run)))

    monkeypatch.setattr("baker.baking.to_pack.bake_to", bake_to)
    return noted


def test_preset_paper_takes_the_papers_resolution_and_no_limit_and_options_change_it(configs, tmp_path, monkeypatch):
    photograph = SimpleNamespace(camera=SimpleNamespace(width=400, height=300))
    run = SimpleNamespace(scene=None, dataset=SimpleNamespace(kind="object"))
    monkeypatch.setattr("training.run.load_run", lambda *_, **__: run)

    def asked(words: str, kind: str = "blender") -> BakeConfig:
        run.scene = SimpleNamespace(kind=kind, splits={"train": (photograph,)})
        assert snerg_bake(["run", "--out", str(tmp_path / "pack"), *words.split()]) == 0
        return configs[-1]

    paper = asked("--preset paper")
    assert (paper.preset, paper.resolution, paper.block_limit) == ("paper", 1000, UNLIMITED)
    assert asked("--preset paper", "llff").resolution == 1300
    assert asked("--preset=paper --resolution 64 --seed 3") == replace(paper, resolution=64, seed=3)
    assert asked("--preset paper --most-macroblocks 9").block_limit == 9
    assert asked("") == BakeConfig(512) == asked("--preset snerg") and BakeConfig().block_limit == MOST_MACROBLOCKS


def test_snerg_make_bakes_presets_as_the_paper_or_our_way(configs, scene, procedural_path, tmp_path, monkeypatch):
    trained = SimpleNamespace(scene=scene, dataset=SimpleNamespace(kind="object"))
    monkeypatch.setattr("training.loop.train", lambda *_, **__: trained)
    papers = ("--preset paper", "--preset deferred", "--preset paper --resolution 64")
    for words in (*papers, "--preset normal --quality compact", "--preset small"):
        assert snerg_make([str(procedural_path), "--out", str(tmp_path / "out"), "--no-view", *words.split()]) == 0
    fine = BakeConfig(1000, "paper")
    ours = BakeConfig(512, "snerg", "compact")
    assert configs == [fine, fine, replace(fine, resolution=64), ours, replace(ours, quality="full")]
    trained.scene = SimpleNamespace(kind="llff")
    assert snerg_make([str(procedural_path), "--out", str(tmp_path / "out"), "--no-view", "--preset", "paper"]) == 0
    assert configs[-1] == BakeConfig(1300, "paper"), "photographs"


def test_each_preset_and_quality_has_its_passes_in_the_papers_order() -> None:
    def names(preset: BakePreset, quality: Quality) -> list[str]:
        return [name for name, _ in passes_of(BakeConfig(preset=preset, quality=quality))]

    ours = ["padding", "sharpening", "pruning", "feature scale", "tuning", "hidden voxels"]
    assert names("snerg", "compact") == names("snerg", "full") == ours and names("snerg", "draft") == ours[:3]
    assert names("paper", "compact") == names("paper", "full") == ["padding", "view MLP"]
    assert names("paper", "draft") == ["padding"], "the paper's row of 8 bits: nothing is emptied, nothing tuned"


def test_the_paper_takes_16_gaussian_samples_of_any_field_and_averages_colours_and_densities_apart(dataset):
    grid = make_grid(np.full(3, -0.9), np.full(3, 0.9), 30, 30, BLENDER_FRAME)
    kept, asked = culled(ball, grid, dataset), []

    def field(points: np.ndarray):
        asked.append(points)
        return ball(points)._replace(diffuse=0.5 + 0.5 * np.sin(40 * points))  # also where it is empty

    grain = np.full(3, grid.voxel_size)  # of a field that our own bake asks once a voxel
    sampler = Sampler(field, grid, kept, grain, as_paper=True)
    with ThreadPoolExecutor(1) as pool:
        places, values = sampler.content(np.argwhere(kept.kept)[:1], pool)
    points = np.concatenate(asked).reshape(len(places), SAMPLES, 3)
    spread = (points - points.mean(1, keepdims=True)).std() * np.sqrt(SAMPLES / (SAMPLES - 1)) / grid.voxel_size
    assert spread == pytest.approx(1 / np.sqrt(12), rel=0.02)
    seen = field(points.reshape(-1, 3))
    alpha = 1 - np.exp(-seen.density.reshape(-1, SAMPLES).mean(1) * grid.voxel_size)
    np.testing.assert_allclose(values[:, 3], alpha, atol=1e-5)
    colour = np.asarray(seen.diffuse).reshape(-1, SAMPLES, 3).mean(1)
    np.testing.assert_allclose(values[:, :3], colour * alpha[:, None], atol=1e-5)
    assert ((alpha > 0.02) & (alpha < 0.9)).any(), "some voxels lie across the border"


def test_the_paper_tunes_the_view_mlp_on_all_pixels_a_photographs_worth_a_step(dataset, monkeypatch):
    pack = random_pack(np.random.default_rng(7), block_size=14, grid_blocks=(3, 3, 3))
    monkeypatch.setattr(tuning, "MARCHED_AT_ONCE", dataset.count // 3 + 1)
    every = shaded_pixels(pack, dataset)
    monkeypatch.setattr(tuning, "MARCHED_AT_ONCE", dataset.count)
    at_once = shaded_pixels(pack, dataset)
    assert every is not None and at_once is not None
    for a, b in zip(every, at_once, strict=True):
        np.testing.assert_allclose(np.sort(np.asarray(a), axis=0), np.sort(np.asarray(b), axis=0), atol=1e-6)

    taken: list[tuple[np.ndarray, int]] = []

    def epoch(head: Any, moments: Any, pixels: Any, order: Any, batch: int, terms: Any) -> Any:
        taken.append((np.asarray(order), batch))
        return real(head, moments, pixels, order, batch, terms)

    real = tuning._epoch
    monkeypatch.setattr(tuning, "_epoch", epoch)
    tuned, figures = tuning.fine_tune(pack, dataset, epochs=2)
    assert figures["train_psnr_after"] > figures["train_psnr_before"]
    assert tuned.view_mlp is not pack.view_mlp and tuned.atlas_rgba is pack.atlas_rgba
    diffuse = replace(pack, view_mlp=None, atlas_features=None)
    assert tuning.fine_tune(diffuse, dataset, epochs=3) == (diffuse, {}), "which has nothing to tune"
    count = len(every.target)
    for order, batch in taken:
        assert batch == -(-count // dataset.views) and sorted(order) == list(range(-(-count // batch))), "each pixel"
    assert not np.array_equal(taken[0][0], taken[1][0])
