"""What other processes do for a report: golden pictures and training. (JAX takes most of a card's memory.)

A child writes into out/work, and what it prints into out/NAME.log. One that takes too long is interrupted as by Ctrl-C, and
killed where that does not help; what it has written until then still counts.
"""

import json
import os
import shutil
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from console.child_process import ChildProcess
from tools.card.parts import Budget, Facts, Skipped

ROOT = Path(__file__).resolve().parents[2]  # of the checkout
GOLDEN = "tests.viewer.rendering.golden_variants"
DEVICES = """
import json, jax
devices = jax.devices()
facts = {"backend": jax.default_backend(), "devices": [d.device_kind for d in devices], "jax": jax.__version__}
try:
    facts["bytes"] = devices[0].memory_stats()["bytes_limit"]
except Exception:
    pass
print(json.dumps(facts))
"""
DEVICES_S, GOLDEN_S, SCENE_S = 120.0, 300.0, 300.0  # at most
ENDING_S = 30.0  # to end in after an interrupt
SCENE_SIZE, SCENE_VIEWS = 400, 60  # of the scene that is rendered where none is at hand
PAPER_S = 240.0  # at most, of the paper's step


@dataclass(frozen=True)
class Ended:
    """What is left of a child. status: its exit status; None where it was stopped. out: what it printed on stdout."""

    status: int | None
    out: str
    log: Path

    @property
    def last_line(self) -> str:
        lines = [line for line in self.log.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
        return lines[-1].strip() if lines else f"exit status {self.status}"


def run_child(words: Sequence[str], log: Path, seconds: float) -> Ended:
    """Runs `python WORDS` with the modules of the checkout for at most `seconds`."""
    log.parent.mkdir(parents=True, exist_ok=True)
    printed = log.with_suffix(".out")
    with open(log, "wb") as errors, open(printed, "wb") as output:
        child = ChildProcess([sys.executable, "-P", *words], stdout=output, stderr=errors)
        try:
            status = child.wait(max(seconds, 0.1))
            if status is None:
                os.kill(child.pid, signal.SIGINT)
                child.wait(ENDING_S)
        finally:
            child.close()
    out = printed.read_text(encoding="utf-8", errors="replace")
    printed.unlink()
    return Ended(status, out, log)


def golden(out: Path, budget: Budget) -> Facts:
    """Compares this card's pictures with those of tests/golden."""
    ended = run_child(["-m", GOLDEN, str(out / "golden")], out / "golden.log", min(GOLDEN_S, budget.left))
    if ended.status != 0:
        raise RuntimeError(f"golden pictures: {ended.last_line}")
    facts = json.loads(ended.out)
    beyond = [name for name, picture in facts["pictures"].items() if not picture["within"]]
    return facts | {"problems": [f"beyond the tolerance: {', '.join(beyond)}"] if beyond else []}


@dataclass
class Training:
    """Trains a scene with a preset after another. scene: None renders one.

    processor_too: also where JAX sees no graphics card.
    """

    out: Path
    scene: Path | None
    downscale: int
    processor_too: bool
    available: bool = False

    def devices(self, budget: Budget) -> Facts:
        """A part: what JAX sees. Skipped, as the other parts are then, where it is not installed or sees no accelerator."""
        ended = run_child(["-c", DEVICES], self.out / "jax.log", min(DEVICES_S, budget.left))
        if ended.status != 0:
            raise Skipped(f"JAX cannot be used: {ended.last_line}")
        facts = json.loads(ended.out)
        if facts["backend"] == "cpu" and not self.processor_too:
            raise Skipped("JAX sees no graphics card; install the extra train-cuda12 or train-cuda13")
        self.available = True
        return facts

    def _scene(self, budget: Budget) -> Path:
        if not self.available:
            raise Skipped("there is nothing to train on: see jax")
        if self.scene is None:
            words = ["-m", "tools.procedural", str(self.out / "work" / "scene")]
            words += ["--size", str(SCENE_SIZE), "--views", str(SCENE_VIEWS)]
            ended = run_child(words, self.out / "scene.log", min(SCENE_S, budget.left))
            if ended.status != 0:
                raise RuntimeError(f"the procedural scene: {ended.last_line}")
            self.scene = self.out / "work" / "scene"
        return self.scene

    def _run(self, preset: str, what: str) -> Path:
        return self.out / "work" / f"{preset}-{what}"

    def _trained(self, preset: str, what: str, words: Sequence[str], budget: Budget, seconds: float) -> Facts:
        from training.recorder import read_metrics

        scene, run = self._scene(budget), self._run(preset, what)
        command = ["-m", "snerg", "train", str(scene), "--out", str(run), "--preset", preset]
        command += ["--downscale", str(self.downscale), *words]
        ended = run_child(command, self.out / f"{preset}-{what}.log", min(seconds, budget.left))
        records = read_metrics(run / "metrics.jsonl")
        if not records:
            raise RuntimeError(f"{preset}: {ended.last_line}")
        facts = {"scene": str(scene), "downscale": self.downscale, "command": command[1:], **speed(records)}
        if ended.status is None:
            facts["stopped"] = "it took too long and was stopped"
        elif ended.status != 0:
            facts["problems"] = [ended.last_line]
        if (run / "curves.png").is_file():
            facts["picture"] = f"{preset}-{what}.png"
            shutil.copyfile(run / "curves.png", self.out / facts["picture"])
        return facts | {"curve": curve(records)}

    def curve_of(self, preset: str, minutes: float, budget: Budget) -> Facts:
        """A part: PSNR of photographs held out over minutes of training."""
        words = ["--minutes", str(minutes), "--validate-views", "8", "--validate-every", "1000"]
        facts = self._trained(preset, "curve", words, budget, 60.0 * minutes + PAPER_S)
        missing = [] if facts["curve"] else ["no photograph was compared"]
        return facts | {"problems": [*facts.get("problems", []), *missing]}

    def step_of(self, preset: str, budget: Budget) -> Facts:
        """A part: what a step takes."""
        words = ["--steps", "100", "--minutes", "2", "--log-every", "10", "--validate-every", "0"]
        facts = self._trained(preset, "step", words, budget, PAPER_S)
        missing = [] if facts["step_ms"] else ["no step was timed"]
        return facts | {"problems": [*facts.get("problems", []), *missing]}

    def parts_of_step(self, preset: str, budget: Budget) -> Facts:
        """A part: the shares of a step of the run that curve_of left."""
        run = self._run(preset, "curve")
        file = run / "step.json"
        if not (run / "metrics.jsonl").is_file():
            raise Skipped(f"there is no run of {preset}")
        words = ["-m", "tools.profile_step", str(run), "--rounds", "15", "--json", str(file)]
        ended = run_child(words, self.out / f"{preset}-parts.log", budget.left)
        if ended.status != 0:
            raise RuntimeError(ended.last_line)
        return json.loads(file.read_text(encoding="utf-8"))


def speed(records: Sequence[Facts]) -> Facts:
    """Medians over the later half of the records, in which everything is compiled; None where nothing was timed."""
    facts: Facts = {"steps": records[-1]["step"], "seconds": records[-1].get("training_seconds")}
    for name in ("steps_per_second", "rays_per_second", "samples_per_second"):
        values = [float(r[name]) for r in records if isinstance(r.get(name), int | float) and r[name] > 0]
        facts[name] = float(np.median(values[len(values) // 2 :])) if values else None
    rate = facts["steps_per_second"]
    return facts | {"step_ms": 1000.0 / rate if rate else None}


def curve(records: Sequence[Facts]) -> list[Facts]:
    """{"step", "minutes" of training, "psnr" of photographs held out}, in the order of steps."""
    return [
        {"step": r["step"], "minutes": r["training_seconds"] / 60.0, "psnr": r["validation_psnr"]}
        for r in records
        if "validation_psnr" in r and "training_seconds" in r
    ]
