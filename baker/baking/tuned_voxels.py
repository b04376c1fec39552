"""The order in which a bake tunes voxels and empties them (beyond SNeRG section 5.6)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from baker.baking.config import BakeConfig
from baker.baking.stages import STAGE, Stages
from baker.baking.views_between import with_views_between
from baker.tuning.hidden import smooth_hidden
from baker.tuning.joint_loop import JointConfig, joint_tune, lost_to_steps, shown_psnr
from baker.tuning.pruning import FIRM, TAU_WEIGHT, UNSEEN, Pruned, light_of, prune, thin
from console import progress
from console.progress import Progress
from scenepack.codecs.quantisation import EXACT, Steps
from scenepack.pack import Pack
from training.dataset import RayDataset

TUNED_TAU = 4.0  # times tau_weight: what tuned voxels are pruned by, where tuning goes on and makes up for it
MOST_LOST = 0.05  # dB of training rays that pruning may cost: scenes that tuning does not help never regain it
MOST_LOST_AGAIN = 0.2  # where tuning goes on: it regains the 0.12 dB that this costs lego at 1000³
MOST_LOST_HIDDEN = 0.03  # by hidden voxels that follow their neighbours, which nothing regains
# dB of held-out views. Lego at 750³ gains 0.55. mary_rose at 512³ loses 0.07, and has gained 0.03 when the rates have fallen.
LEAST_GAIN = 0.1
# Of the usual rates, where these learn by heart what photographs disagree in. mary_rose at 512³ gains 0.13 dB of its test views,
# with a tenth of the rates 0.05.
GENTLE = 0.3
SECOND_RATE = 1.5  # of colours and features, in units of 1/255, once they are tuned
# Lego's compact pack at 1000³ ends at 34.19 dB after so many passes in steps of 3, at 34.14 dB after one in steps of 4.
SECOND_PASSES, SECOND_MOST_STEPS = 1.3, 1100
COMPACT = Steps(3, 12, 8)  # of what is stored; on lego at 1000³ they cost 0.2 dB before tuning, which regains it
# dB of training rays that COMPACT steps may cost before tuning. Lego at 1000³ loses 0.19, and 0.04 of its test views in the end.
# Fern at 512³, whose mist takes 38 samples a ray, loses 0.75, and 0.22 in the end: a grain on walls (LPIPS 0.263, not 0.198).
# Glass loses 1.6, and fox 12.8.
MOST_LOST_ROUNDED = 0.4


def with_tuned_voxels(
    pack: Pack, dataset: RayDataset, config: BakeConfig, stages: Stages, by_opacity: bool
) -> tuple[Pack, dict[str, Any], Pruned | None]:
    """The pack with voxels and view MLP fine-tuned, figures, and what is pruned meanwhile.

    First some views are held out, which tell whether tuning helps. Where it does, voxels are pruned once more, harder than
    those that nothing makes up for, and tuning goes on, on all views. A scene whose photographs disagree (rough masks, things
    that move) is tuned gently instead, and is mist where they do: pruning it costs too much, and is left. What is compact is
    rounded where tuning goes on, which therefore it does in any case; then hidden voxels follow their neighbours, as far as
    that costs next to nothing.
    With config.thin, that pruning is thinning, by so much more: lego at 750³ loses 0.42 dB of training rays, and regains 0.46.
    """
    name, label = "voxels and view MLP", "fine-tuning voxels and view MLP"
    first = JointConfig(seed=config.seed, least_gain=LEAST_GAIN)
    with stages(name), progress(label, 1.0, stage=STAGE) as bar:
        pack, figures = joint_tune(pack, dataset, first, bar.update, by_opacity)
    if not figures:
        return pack, figures, None
    helps = _helped(figures)
    if not helps:
        with stages(name), progress(f"{label}, gently", 1.0, stage=STAGE) as bar:
            gentle = replace(first.slower(GENTLE), least_gain=0.0)
            pack, gently = joint_tune(pack, dataset, gentle, bar.update, by_opacity)
        figures = {**gently, "passes": round(figures["passes"] + gently["passes"], 2), "gently": _helped(gently)}
    if not (helps or config.fine_tune == "compact"):
        figures["of"] = "all"
        return pack, figures, None
    removed = None
    if helps and config.tau_weight > 0:
        with stages("pruning again"), progress("emptying voxels that are faint now", 1.0, stage=STAGE) as bar:
            if config.thin > 0:
                pack, removed = thinned(pack, dataset, config, by_opacity, False, bar, MOST_LOST_AGAIN + config.thin)
            else:
                pack, removed = pruned(pack, dataset, config, by_opacity, bar, again=True)
            bar.update(1.0)
    coarse = config.fine_tune == "compact"
    if config.fine_tune == "auto":
        with stages(name), progress("trying coarser steps", 1.0, stage=STAGE) as bar:
            lost = lost_to_steps(pack, dataset, COMPACT, config.seed, by_opacity=by_opacity)
            bar.update(1.0)
        figures["lost_to_steps"] = round(lost, 3)
        coarse = figures["lost_to_steps"] <= MOST_LOST_ROUNDED
    figures["of"] = "compact" if coarse else "all"
    second = JointConfig(
        SECOND_PASSES, SECOND_MOST_STEPS, seed=config.seed + 1, held_out=0 if helps else first.held_out, rate=SECOND_RATE,
        steps=COMPACT if coarse else EXACT,
    )  # fmt: skip
    with stages(name), progress(f"{label}, {'all views' if helps else 'in coarser steps'}", 1.0, stage=STAGE) as bar:
        pack, last = joint_tune(pack, dataset, second, bar.update, by_opacity)
    figures |= {
        "passes": round(figures["passes"] + last["passes"], 2), "samples_a_ray_after": last["samples_a_ray_after"],
    }  # fmt: skip
    if coarse:
        with stages("hidden voxels"), progress("smoothing hidden voxels", 1.0, stage=STAGE) as bar:
            light = light_of(pack, with_views_between(dataset), config.seed, _light(bar))
            if light is not None:
                smoothed = smooth_hidden(pack, light, COMPACT, _score(dataset, config, by_opacity), MOST_LOST_HIDDEN)
                pack, figures["hidden_below"] = smoothed
            bar.update(1.0)
    return pack, figures, removed


def _helped(figures: dict[str, Any]) -> bool:
    return figures["held_out_psnr_after"] > figures["held_out_psnr_before"]


def pruned(
    pack: Pack, dataset: RayDataset, config: BakeConfig, by_opacity: bool, bar: Progress, *, again: bool = False
) -> tuple[Pack, Pruned]:
    """The pack without the voxels that are faint by tau_weight, or by less where training rays would lose too much.

    again: of a pack that was tuned, harder, since tuning goes on.
    """
    tau_weight, closing, most_lost = config.tau_weight, UNSEEN, MOST_LOST
    if again:
        tau_weight, closing, most_lost = TUNED_TAU * config.tau_weight, FIRM, MOST_LOST_AGAIN

    views, score = with_views_between(dataset), _score(dataset, config, by_opacity)
    return prune(pack, views, tau_weight, config.seed, _light(bar), closing, score, most_lost)


def thinned(
    pack: Pack, dataset: RayDataset, config: BakeConfig, by_opacity: bool, compact: bool, bar: Progress,
    most_lost: float | None = None,
) -> tuple[Pack, Pruned | None]:  # fmt: skip
    """The pack as thin as it may be where training rays lose most_lost dB, by default config.thin. compact: it is stored in
    COMPACT steps.
    """
    light = light_of(pack, with_views_between(dataset), config.seed, _light(bar))
    if light is None:
        return pack, None
    tau_weight, steps = config.tau_weight or TAU_WEIGHT, COMPACT if compact else EXACT
    most_lost = config.thin if most_lost is None else most_lost
    return thin(pack, light, tau_weight, steps, _score(dataset, config, by_opacity), most_lost)


def _light(bar: Progress) -> Callable[[float], None]:
    """For light_of, whose half of the work is followed by trials of what it allows."""
    return lambda share: bar.update(0.5 * share, "light" if share < 1 else "trials")


def _score(dataset: RayDataset, config: BakeConfig, by_opacity: bool) -> Callable[[Pack], float]:
    """How well a pack shows training rays, dB."""
    return lambda pack: shown_psnr(pack, dataset, config.seed, by_opacity=by_opacity)
