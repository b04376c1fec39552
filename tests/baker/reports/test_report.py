"""snerg-report: its figures are those of the commands it stands for, and those recorded; its pictures those of the packs.

The field is that of tests/data/runs/multires, a checkpoint, so that its figures are the same on every machine but for rounding.
tests/data/report.json holds what they were: SNERG_RECORD_REPORT=1 writes it anew. Look at each figure before you commit that.
"""

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from baker.baking import passes
from baker.baking.config import BakeConfig
from baker.commands.evaluate import main as snerg_eval
from baker.commands.report import main as snerg_report
from baker.reports import paper_figures
from baker.reports.fields import LARGE, OWN, row_of, size_of_rows
from baker.reports.options import TABLES, ReportOptions
from baker.reports.paper_figures import GPU_GB, MILLISECONDS, QUALITY, RELEASE, SCENES, SPEED, Kind
from baker.reports.report import open_study, provenance, write_tables
from baker.tuning.fine_tune import fine_tune
from baker.tuning.joint_tuning import JointConfig
from scenepack import load_pack, save_pack, writer
from scenepack.files import stored_bytes
from tests.scenepack.helpers import edit_json
from tests.scenepack.random_packs import random_pack
from tests.stand_ins import raising
from tests.stored_runs import SCENE, STORED
from training.config import PRESETS
from training.run import Run
from training.scenes.presets import PresetName

RECORD = STORED.parent / "report.json"
# Of tuning, so that the tests are quick, and their figures hardly depend on the processor. Tests of its own look at it.
EPOCHS, STEPS = 2, 3


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A run, and one that says of itself that it had no sparsity loss: its colours are others."""
    folder = tmp_path_factory.mktemp("runs")
    sparse, foggy = folder / "sparse", folder / "foggy"
    for path in (sparse, foggy):
        shutil.copytree(STORED / "multires", path)
    edit_json(foggy / "config.json", lambda description: description["config"].update(sparsity_weight=0.0))
    return sparse, foggy


@pytest.fixture(scope="module")
def out(runs: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "out"
    of = {"resolution": 46, "resolutions": "40,46", "quality": "draft", "against": runs[1]}
    options = ReportOptions(out, SCENE, **of, frames=2, size="32x32", quick=True)
    with pytest.MonkeyPatch.context() as quick:
        quick.setattr(passes, "fine_tune", partial(fine_tune, epochs=EPOCHS))
        quick.setattr(passes, "JointConfig", partial(JointConfig, most_steps=STEPS))
        write_tables(open_study(runs[0], options), TABLES)
    return out


@pytest.fixture(scope="module")
def tables(out: Path) -> dict[str, Any]:
    return json.loads((out / "report.json").read_text())["tables"]


def rows_of(table: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {row["row"]: row for row in table["rows"]}


def steady(value: Any, name: str = "") -> Iterator[tuple[str, float]]:
    """The figures of a document that depend on neither the machine nor the folder, by their places; not the paper's, nor what
    was asked for.
    """
    others = {"seconds", "stages", "ms_mean", "ms_std", "ms_p50", "fps", "encode_s", "decode_s", "watts", "fps_per_watt", "lpips",
              "alpha_histogram", "figures", "views", "paper", "release", "about", "default", "width", "height", "frames",
              "fov", "sparsity_weight", "paper_is_masked", "at"}  # fmt: skip
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in others and not key.startswith("foggy"):  # the same field once more
                yield from steady(inner, f"{name}/{key}")
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            place = inner["row"] if isinstance(inner, dict) and "row" in inner else i
            yield from steady(inner, f"{name}/{place}")
    elif isinstance(value, int | float):
        yield name, value


@pytest.mark.slow
def test_the_tables_are_made_again_as_they_were_recorded(out: Path) -> None:
    made = dict(steady(json.loads((out / "report.json").read_text())))
    if os.environ.get("SNERG_RECORD_REPORT"):
        RECORD.write_text(json.dumps(made, indent=1) + "\n")
    recorded = json.loads(RECORD.read_text())
    assert list(made) == list(recorded), "every table, row and figure"
    for name, value in recorded.items():
        rel, most = (0.0, 0.1) if "psnr" in name else (0.03, 0.005)  # of bytes, counts, SSIM, shares
        assert made[name] == pytest.approx(value, rel=rel, abs=most), name


@pytest.mark.slow
def test_every_row_of_the_paper_is_there_measured_or_with_the_command_that_would_make_it(tables):
    quality = rows_of(tables["quality"])
    papers = ["jaxnerf-plus", "tinyview", "deferred", "float", "8-bit", "snerg", "no-sparsity", "diffuse"]
    assert set(papers) < set(quality)
    for name in papers:
        assert quality[name]["paper"], name
        lacks = name in ("jaxnerf-plus", "tinyview", "deferred", "diffuse")
        assert ("command" in quality[name]) == lacks == ("psnr" not in quality[name]), name
    assert "--preset tinyview" in quality["tinyview"]["command"] and "--baselines" in quality["tinyview"]["command"]
    assert {"jaxnerf-plus", "jaxnerf"} < set(rows_of(tables["storage"]))
    assert all(row["ms_p50"] > 0 for row in tables["performance"]["rows"])


def test_fields_of_any_size_make_a_ladder_around_a_run_of_theirs() -> None:
    small = {"width": 128, "coarse_samples": 63, "fine_samples": 126}
    tiny = {"width": 64, "coarse_samples": 21, "fine_samples": 42}
    rows: dict[PresetName, dict[str, int]] = {"deferred": small, "tinyview": small, "jaxnerf": tiny}
    configs = {name: replace(PRESETS[name], nerf=replace(PRESETS[name].nerf, **sizes)) for name, sizes in rows.items()}
    large = size_of_rows(configs["deferred"])
    assert {name: row_of(config, large) for name, config in configs.items()} == {name: name for name in rows}
    assert {row_of(config) for config in configs.values()} == {OWN}, "they are none of the paper's size"
    assert size_of_rows(PRESETS["quick"]) == size_of_rows(PRESETS["jaxnerf"]) == LARGE, "beside these stand the paper's"
    assert row_of(PRESETS["jaxnerf"]) == "jaxnerf" and row_of(PRESETS["paper"]) == "deferred"


@pytest.mark.slow
def test_scores_are_those_of_snerg_eval(out: Path, tables: dict[str, Any], tmp_path: Path) -> None:
    quality, real = rows_of(tables["quality"]), rows_of(tables["real"])
    paper = out / "packs/paper-46-full"
    for row, subject, extra in (
        (quality["snerg"], paper, []),
        (real["ours-full"]["masked"], out / "packs/snerg-46-full", ["--mask-of", str(paper)]),
    ):
        words = [str(subject), "--scene", str(SCENE), "--json", str(tmp_path / "e.json"), *extra]
        assert snerg_eval(words) == 0
        told_by = json.loads((tmp_path / "e.json").read_text())
        assert row["psnr"] == pytest.approx(told_by["psnr"], abs=1e-6)
        assert row["ssim"] == pytest.approx(told_by["ssim"], abs=1e-6)
    assert quality["float"]["psnr"] != quality["8-bit"]["psnr"] != quality["snerg"]["psnr"]
    assert quality["8-bit"]["bytes"] == stored_bytes(out / "packs/paper-46-draft")
    text = (out / "report.md").read_text()
    assert f"| {quality['8-bit']['psnr']:.2f} |" in text and f"{quality['field']['psnr']:.2f}" in text


@pytest.mark.slow
def test_a_report_of_a_box_compares_only_where_the_papers_bake_of_it_is_opaque(runs, tmp_path, monkeypatch) -> None:
    weighted: list[bool] = []

    def tuned(pack: Any, photographs: Any, **how: Any) -> Any:
        weighted.append(how["by_opacity"])
        return fine_tune(pack, photographs, epochs=EPOCHS, **how)

    monkeypatch.setattr(passes, "fine_tune", tuned)
    box = "-0.5,-0.5,-1.5,0.5,0.5,1.5"
    words = [str(runs[0]), "--out", str(tmp_path / "out"), "--scene", str(SCENE), "--resolution=40", "--quick"]
    words += [f"--aabb={box}"]
    assert snerg_report([*words, "--tables", "storage"]) == 0
    paper = tmp_path / "out/packs/paper-40-full"
    pack = load_pack(paper)
    low, high = pack.min_xyz, pack.min_xyz + pack.voxel_size * np.array(pack.grid_size)
    assert (np.abs([low[[0, 2]], high[[0, 2]]]) < 1.5).all()  # x and, in the grid frame, z of the box
    assert weighted == [True]
    document = json.loads((tmp_path / "out/report.json").read_text())
    assert document["about"]["aabb"] == [-0.5, -0.5, -1.5, 0.5, 0.5, 1.5]
    assert f"baked of the box {box}" in (tmp_path / "out/report.md").read_text()
    eval_words = [str(paper), "--scene", str(SCENE), "--json", str(tmp_path / "e.json")]
    scores = []
    for mask in (["--mask-by-alpha"], []):
        assert snerg_eval([*eval_words, *mask]) == 0
        scores.append(json.loads((tmp_path / "e.json").read_text())["psnr"])
    row = rows_of(document["tables"]["storage"])["png"]
    assert row["psnr"] == pytest.approx(scores[0], abs=1e-6) and scores[0] > scores[1] + 1
    assert snerg_report([*words[:-1], "--aabb=9,9,9,10,10,10"]) == 2, "nothing was trained there"


@pytest.mark.slow
def test_every_picture_that_the_report_shows_is_there(out: Path) -> None:
    text = (out / "report.md").read_text()
    shown = [part.split(")")[0] for part in text.split("](")[1:]]
    some = ("resolution", "storage", "sparsity", "cross-section-x", "fine-tuning", "ablation")
    assert {f"{name}.png" for name in some} <= set(shown)
    for name in shown:
        with Image.open(out / name) as picture:
            assert np.asarray(picture.convert("L")).std() > 1, name


@pytest.mark.slow
def test_the_same_study_again_bakes_and_scores_nothing(out, runs, monkeypatch):
    for name in ("bake_to", "evaluate", "bake_floats"):
        monkeypatch.setattr(f"baker.reports.report_cache.{name}", raising(AssertionError("was made before")))
    figures = json.loads((out / "report.json").read_text())
    options = ReportOptions(out, SCENE, resolution=46, resolutions="46", quality="draft", against=runs[1])
    write_tables(open_study(runs[0], options), ["quality", "real"])
    assert json.loads((out / "report.json").read_text()) == figures, "tables that are not asked for stay"


@pytest.mark.slow
def test_reports_of_several_scenes_stand_side_by_side_with_their_mean(out, tmp_path, refused):
    document = json.loads((out / "report.json").read_text())
    for name, more in (("lego", 0.0), ("chair", 2.0)):
        document["about"]["name"] = name
        for row in document["tables"]["quality"]["rows"]:
            if "psnr" in row:
                row["psnr"] += more
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.json").write_text(json.dumps(document))
    both = [str(tmp_path / "lego"), str(tmp_path / "chair")]
    assert snerg_report([*both, "--out", str(tmp_path / "both")]) == 0
    made = json.loads((tmp_path / "both/report.json").read_text())["tables"]
    snerg = rows_of(made["quality psnr"])["snerg"]
    assert snerg["values"]["chair"] == pytest.approx(snerg["values"]["lego"] + 2)
    assert snerg["mean"] == pytest.approx(snerg["values"]["lego"] + 1)
    assert snerg["paper"] == {"lego": 33.82, "chair": 33.24} and snerg["paper_mean"] == pytest.approx(33.53)
    lacking = rows_of(made["quality psnr"])["jaxnerf-plus"]
    assert lacking["mean"] is None and lacking["paper_mean"] == pytest.approx(35.35)
    text = (tmp_path / "both/report.md").read_text()
    assert "| *SNeRG (PNG), the paper* | *33.53* | *33.82* | *33.24* |" in text
    assert rows_of(made["performance gpu_bytes"])["ours"]["paper"]["lego"] == pytest.approx(0.74e9)

    assert "one scene" in refused(snerg_report, both[0], both[0], "--out", tmp_path / "twice")
    assert "holds no report" in refused(snerg_report, both[0], tmp_path, "--out", tmp_path / "none")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--tables", "quality,prices"], "--tables"),
        (["--resolutions", "big"], "--resolutions"),
        (["--resolution", "12"], "--resolution"),
        (["--split", "holiday"], "--split"),
        (["--fine-tune", "most"], "--fine-tune"),
        (["--against", "nowhere"], "nowhere"),
        (["--against", "{run}"], "trained with the sparsity loss"),
        (["--baselines", "{foggy}"], "no row of the paper"),
    ],
)
def test_what_cannot_be_done_is_told_in_one_line_before_anything_is_baked(runs, tmp_path, refused, words, expected):
    words = [word.format(run=runs[0], foggy=runs[1]) for word in words]
    assert expected in refused(snerg_report, runs[0], "--scene", SCENE, "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


def test_each_pack_is_baked_once_and_none_stands_for_one_of_other_options(tmp_path, monkeypatch) -> None:
    bakes: list[str] = []

    def bake_to(run: Run, config: BakeConfig, out: Path) -> dict[str, float]:
        bakes.append(f"{config.preset} {config.quality} {config.seed}")
        save_pack(random_pack(np.random.default_rng(0)), out)
        return {"writing": float(len(bakes))}

    monkeypatch.setattr("baker.reports.report_cache.bake_to", bake_to)
    study = open_study(STORED / "multires", ReportOptions(tmp_path / "out", SCENE, resolution=46))
    full = study.baked("snerg")
    compact = study.baked("snerg", quality="compact")
    assert study.baked("snerg", quality="full") == full and study.baked("snerg", quality="compact") == compact
    assert full.path != compact.path
    study.baked("paper")
    assert study.baked("snerg", seed=7).key != full.key
    assert bakes == ["snerg full 0", "snerg compact 0", "paper full 0", "snerg full 7"]


def test_a_bare_checkout_without_git_can_say_what_made_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "version", raising(PackageNotFoundError()))
    monkeypatch.setenv("PATH", "")
    assert provenance()["commit"] == "0"


@pytest.mark.parametrize("kind", list(QUALITY))
def test_the_printed_means_are_the_means_of_the_printed_scenes(kind: Kind) -> None:
    for metric, rows in QUALITY[kind].items():
        for row, (mean, *scenes) in rows.items():
            assert len(scenes) == len(SCENES[kind]), row
            if None not in scenes:
                allowed = 0.011 if metric == "psnr" else 0.0011
                assert np.mean(np.array(scenes, float)) == pytest.approx(mean, abs=allowed), (metric, row)
    for rows in (MILLISECONDS, GPU_GB):
        for row, (mean, *scenes) in rows.items():
            known = [value for value in scenes if value is not None]
            assert np.mean(known) == pytest.approx(mean, abs=0.06), row
    for row, (mean, *scenes) in RELEASE["synthetic"].items():
        assert np.mean(np.array(scenes, float)) == pytest.approx(mean, abs=0.01), row
    for row, (*scores, watts, fps, each) in SPEED.get(kind, {}).items():
        assert row not in QUALITY[kind]["psnr"] or scores == [rows[row][0] for rows in QUALITY[kind].values()], row
        if fps >= 0.3:
            assert each == pytest.approx(fps / watts, rel=0.02), row


def test_a_scene_of_the_papers_gets_its_own_figures_and_others_the_mean_of_their_kind() -> None:
    assert paper_figures.quality("synthetic", "Lego", "snerg") == {"psnr": 33.82, "ssim": 0.973, "lpips": 0.022}
    assert paper_figures.quality("synthetic", "jewels", "snerg") == {"psnr": 30.38, "ssim": 0.950, "lpips": 0.050}
    assert paper_figures.quality("real360", "mary_rose", "tinyview") is None
    assert paper_figures.release("forward", "fern", "snerg") == 24.93
    assert paper_figures.performance("real360", "pine_cone", "ours") == {"fps": 39.5}
    assert paper_figures.performance("synthetic", "ficus", "no-sparsity") == {"ms": None, "gpu_gb": 7.57}
    assert "lego" in paper_figures.whose("synthetic", "lego") and "mean" in paper_figures.whose("synthetic", "jewels")
