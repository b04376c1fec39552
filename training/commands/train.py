"""`snerg-train SCENE --out RUN`: photographs to a trained radiance field (docs/commands.md)."""

import argparse
import contextlib
import dataclasses
import sys
from collections.abc import Callable, Container, Sequence
from pathlib import Path
from typing import Annotated, cast

import tyro

from console import UserError, run_command
from training.config import PRESETS, TrainConfig, require_valid
from training.libraries import find_devices, import_libraries
from training.scenes import SceneOptions
from training.scenes.presets import PresetName, names_with_about
from training.scenes.scene_options import parse_box, parse_up

DEFAULT_PRESET = "normal"
PRESET_HELP = f"Named settings. The defaults below are those of the chosen preset. {names_with_about(PresetName)}."
# Settings that --resume may change: the run's length and its reports.
FREE = ("steps", "minutes", "log_every", "validate_every", "validate_views", "checkpoint_every")


def main(args: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status."""
    args = sys.argv[1:] if args is None else args
    return run_command(make_command(args), prog="snerg-train", args=args)


def make_command(args: Sequence[str]) -> Callable[..., None]:
    """The command whose defaults are the preset's (with --resume: the run's own), so that options change single fields.

    Bad values of --preset and --out are left to the parser and the command.
    """
    name, out, resuming = _look_ahead(args)
    defaults = PRESETS.get(cast(PresetName, name), PRESETS[DEFAULT_PRESET])
    if resuming and out is not None:
        from training.run import read_description

        with contextlib.suppress(UserError):  # the command raises it again
            defaults = read_description(out).config

    def snerg_train(
        scene: Path,
        /,
        out: Path,
        config: Annotated[TrainConfig, tyro.conf.arg(name="")] = defaults,
        preset: Annotated[PresetName, tyro.conf.arg(help=PRESET_HELP)] = DEFAULT_PRESET,
        downscale: int | None = None,
        spherify: bool = False,
        masks: bool = False,
        aabb: str | None = None,
        up: str | None = None,
        resume: bool = False,
        coordinator: str | None = None,
        processes: int | None = None,
        process_id: int | None = None,
    ) -> None:
        """Trains a radiance field on photographs with camera poses. You can stop and resume a run at any time.

        Args:
            scene: Folder of photographs with camera poses. docs/scenes.md lists the layouts.
            out: Folder of the run: configuration, checkpoints, metrics, validation pictures.
            config: Every setting of the preset is also an option.
            downscale: Divide width and height of the photographs by this whole number. The default is 1.
            spherify: Read an LLFF or COLMAP scene as a 360 degree scene although its cameras look forward.
            masks: Cut the object out with the masks next to the pictures.
            aabb: Box of the content, x0,y0,z0,x1,y1,z1 in the training frame. The default is the box that is printed when
                training starts. Not for forward-facing scenes, which are in NDC.
            up: What is up, x,y,z in the training frame as it is without this option. Only for COLMAP scenes that are seen from
                all around. The default is the mean up direction of the cameras.
            resume: Continue the run in --out from its newest checkpoint, with its own settings.
            coordinator: HOST:PORT of process 0, if several processes train together and their launcher does not provide it.
                Slurm, MPI and Kubernetes usually need none of these three options. See docs/distributed.md.
            processes: Number of processes that train together.
            process_id: Number of this process, from 0.
        """
        import_libraries()  # JAX starts here, not for --help
        from training.devices import is_writer, join_processes

        require_valid(config)
        join_processes(coordinator, processes, process_id)
        find_devices()
        from training.loop import train
        from training.run import read_description

        box, upwards = parse_box(aabb), parse_up(up)
        if resume:
            stored = read_description(out)
            if changed := changed_settings(stored.config, config, leave_out=FREE):
                names = ", ".join("--" + name for name in changed)
                remedy = "leave them out, or start another run"
                raise UserError("a resumed run keeps its settings", where=names, remedy=remedy)
            flags = {"spherify": spherify or None, "masks": masks or None}  # None: left out
            asked = {"downscale": downscale, **flags, "aabb": box, "up": upwards}
            stored.options.require_unchanged(asked, "leave it out with --resume")
            run = train(scene, out, config, resume=stored)
        else:
            options = SceneOptions(1 if downscale is None else downscale, spherify or None, masks, box, upwards)
            run = train(scene, out, config, options)
        if is_writer():
            print(f"{out}: {run.step} of {config.steps} steps done; bake it with: snerg-bake {out} --out PACK")

    return snerg_train


def changed_settings(before: object, after: object, leave_out: Container[str] = (), prefix: str = "") -> list[str]:
    """Names, as on the command line, of the settings in which two configs of one class differ."""
    names = []
    for field in dataclasses.fields(before):  # type: ignore[arg-type]
        old, new = getattr(before, field.name), getattr(after, field.name)
        if old == new or field.name in leave_out:
            continue
        name = prefix + field.name
        nested = dataclasses.is_dataclass(old)
        names += changed_settings(old, new, (), f"{name}.") if nested else [name.replace("_", "-")]
    return names


def _look_ahead(args: Sequence[str]) -> tuple[str, Path | None, bool]:
    """(--preset, --out, --resume), as far as the words make them clear before all options are parsed."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    parser.add_argument("--preset", default=DEFAULT_PRESET)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--resume", action="store_true")
    try:
        known, _ = parser.parse_known_args(list(args))
    except (argparse.ArgumentError, SystemExit):
        return DEFAULT_PRESET, None, False
    return known.preset, known.out, known.resume
