"""What a run has so far as a small pack: it looks like the field, is written now and then, and never stops a training."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from baker.baking import to_pack
from baker.baking.to_pack import FIRST_STEP, Previews, preview_pack
from baker.tuning.joint_tuning import shown_psnr
from console import UserError
from scenepack import load_pack
from tests.stand_ins import raising
from training.config import QUICK
from training.loop import train
from training.multires.config import MultiresConfig
from training.recorder import read_metrics
from training.run import Run

SMALL = MultiresConfig(resolutions=(8, 16, 32), occupancy=32, samples_per_step=8192, steps_across=(48, 64, 64))
CONFIG = dataclasses.replace(QUICK, engine="fused", steps=130, log_every=10, validate_every=0, multires=SMALL)


class Noting(Previews):
    """Notes when it was asked, and wants one preview early, and another late."""

    def __init__(self, out: Path) -> None:
        super().__init__(out, 0.0)
        self.asked: list[int] = []
        self.seen: list[int] = []

    def due(self, run: Run) -> bool:
        self.asked.append(run.step)
        return run.step in (FIRST_STEP, 120)

    def write(self, run: Run) -> None:
        super().write(run)
        self.seen.append(load_pack(self.out).metadata["provenance"]["steps"])


@pytest.fixture(scope="module")
def trained(procedural_path: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Noting]:
    folder = tmp_path_factory.mktemp("previewed")
    previews = Noting(folder / "preview.zip")
    return train(procedural_path, folder / "run", CONFIG, after_step=previews.update), previews


def test_previews_are_asked_for_after_each_step_and_leave_the_run_as_it_is(trained, procedural_path, tmp_path):
    run, previews = trained
    assert previews.asked == list(range(1, CONFIG.steps)) and previews.seen == [FIRST_STEP, 120]
    alone = train(procedural_path, tmp_path / "run", CONFIG)
    np.testing.assert_equal(alone.method.save(alone.state), run.method.save(run.state))


def test_a_preview_looks_like_the_field_and_says_after_how_many_steps(trained: tuple[Run, Noting]) -> None:
    run, previews = trained
    pack = preview_pack(run, 60)
    assert pack is not None and pack.view_mlp is not None and max(pack.grid_size) <= 3 * 30
    of_field = np.mean([r["psnr"] for r in read_metrics(run.path / "metrics.jsonl")[-5:] if "psnr" in r])
    assert shown_psnr(pack, run.dataset, 0) > of_field - 2.0
    assert pack.metadata["provenance"]["steps"] == CONFIG.steps
    early = load_pack(previews.out)
    assert early.metadata["provenance"]["steps"] == 120 and early.metadata["cameras"]
    previews.remove()
    previews.remove()
    assert not previews.out.exists()


@pytest.mark.parametrize("failure", [UserError("the disk is full"), OSError(28, "no space"), MemoryError()])
def test_a_preview_that_fails_does_not_stop_the_training(trained, tmp_path, monkeypatch, failure):
    monkeypatch.setattr(to_pack, "preview_pack", raising(failure))
    Previews(tmp_path / "preview.zip", 0.0).write(trained[0])
    assert not (tmp_path / "preview.zip").exists()
