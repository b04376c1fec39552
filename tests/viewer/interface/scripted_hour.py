"""Random but plausible use of everything at once: packs, photographs, comparisons, films, exports, dialogs, controllers.

    python -m tests.viewer.interface.scripted_hour --events 3000 --seed 0

Each event goes to the whole interface in a framebuffer, as a mouse, a keyboard or a file manager would send it. After each one,
OpenGL is asked for errors, and what the dialogs say is read. Every so often all is closed and memory is measured. Nothing is
trained: a scene that shall be made is declined. Prints JSON; status 1 for anything found. A seed's events are always the same.
"""

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import moderngl
from imgui_bundle import imgui

from scenepack import save_pack
from tests.viewer.conftest import toy_pack
from tests.viewer.offscreen_ui import PLACES, OffscreenUi
from tests.viewer.scenes import photographed
from tools.fuzz.memory import resident, with_steady_memory
from viewer.app.application import App
from viewer.app.commands import COMMANDS
from viewer.core.input import ControllerState
from viewer.core.state import SCALES
from viewer.core.theme import THEMES
from viewer.features.making import survey
from viewer.interface.layout import PAGES
from viewer.rendering.offscreen import create_context

SIZES = ((640, 400), (480, 360), (800, 600), (620, 420))
KEYS = [key for key in PLACES if key not in (imgui.Key.f11,)]
MODIFIERS = ((), (), (), (imgui.Key.mod_ctrl,), (imgui.Key.mod_shift,), (imgui.Key.mod_ctrl, imgui.Key.mod_shift))
OFF_LIMITS = ("quit", "quit-unsaved", "stop-and-quit", "full-screen", "make-again", "share")
TEXTS = ("lego", "0", "12", "-3.5", "päck 日本", "x" * 40)
DIALOG_BUTTONS = (("OK", ""), ("Home", "home"))
BUGS = ("This is a bug", "Traceback", "object at 0x")
ROUND = 250  # events from one measurement of memory to the next
WARM_UP = 2  # rounds
ESCAPES = 40  # that answer the dialogs of an event
# Of growth: fonts and pools move 5 of some 125 MiB from round to round, forgotten framebuffers a third.
TOLERATED = 0.06


class Hour:
    """The interface with a folder of things to open, and what was done to it."""

    def __init__(self, ctx: moderngl.Context, folder: Path, seed: int) -> None:
        self.random, self.folder, self.ctx = random.Random(seed), folder, ctx
        survey.MEASURES = False
        self.app = App()
        making: Any = self.app.making
        making.start = lambda host: making.dismiss()
        making.check_photographs = lambda host: None
        self.ui = OffscreenUi(ctx, self.app, size=SIZES[0])
        self.done: Counter[str] = Counter()
        self.found: list[str] = []
        self.packs = self._prepare()
        pick, ui, app = self.random.choice, self.ui, self.app
        others = [self.folder / name for name in ("scene", "broken", "notes.txt", "gone")]
        commands = [name for name in COMMANDS if name not in OFF_LIMITS]
        self.events: dict[str, tuple[int, Callable[[], object]]] = {  # by name: how often, and what
            "click": (20, lambda: ui.click(*self.place(), pick((0, 0, 0, 1, 2)))),
            "drag": (8, lambda: ui.drag([self.place(), self.place()], pick((0, 0, 1, 2)))),
            "wheel": (4, lambda: ui.wheel(self.random.uniform(-3, 3), *self.place())),
            "key": (14, lambda: ui.key(*pick(MODIFIERS), pick(KEYS))),
            "command": (10, lambda: app.run(pick(commands))),
            "page": (8, lambda: app.interface.opens(pick(PAGES).id)),
            "resize": (2, lambda: ui.resize(*pick(SIZES))),
            "open": (4, lambda: app.open(pick(self.packs))),
            "drop": (2, lambda: app.drop([pick([*self.packs, *others])])),
            "paste": (2, self.paste),
            "type": (3, lambda: ui.io.add_input_characters_utf8(pick((*TEXTS, f"{self.folder}/")))),
            "photograph": (3, self.photograph),
            "compare": (2, lambda: app.open(pick(self.packs[:2]), other=True)),
            "export": (3, self.export),
            "look": (2, self.look),
            "controller": (3, self.controller),
            "dialog": (1, lambda: app.messages.fail("Something failed", "in plain words", buttons=DIALOG_BUTTONS)),
            "wait": (4, self.wait),
        }
        self.close_all()

    def _prepare(self) -> list[Path]:
        known = photographed(toy_pack(), self.folder / "scene", 3)
        save_pack(known, self.folder / "known")
        save_pack(toy_pack(view_mlp=False, seed=2), self.folder / "diffuse")
        save_pack(toy_pack(ndc=True), self.folder / "forward")
        shutil.make_archive(str(self.folder / "zipped"), "zip", self.folder / "diffuse")
        (self.folder / "broken").mkdir()
        (self.folder / "broken" / "scene_params.json").write_text("{")
        (self.folder / "notes.txt").write_text("hello")
        return [self.folder / name for name in ("known", "diffuse", "forward", "zipped.zip")]

    def place(self) -> tuple[float, float]:
        width, height = self.ui.size
        return self.random.uniform(0, width), self.random.uniform(0, height)

    def paste(self) -> None:
        self.app.clipboard.text = self.random.choice([str(self.random.choice(self.packs)), *TEXTS])
        self.app.run("paste")

    def photograph(self) -> None:
        gallery = self.app.gallery
        gallery.frusta = self.random.random() < 0.5
        if self.app.scene is not None and gallery.photographs.shots:
            self.app.run(self.random.choice(("next-photo", "last-photo")))
        self.app.comparison.how = self.random.choice(("wipe", "flip", "difference"))

    def export(self) -> None:
        app = self.app
        if app.scene is None or app.filming.export is not None:
            return
        app.filming.size, app.filming.samples = self.random.choice(((48, 36), (37, 64))), self.random.choice((1, 2))
        number = self.done["export"]
        try:
            if self.random.random() < 0.5:
                app.filming.still(app, self.folder / f"still-{number}.png")
            else:
                app.run("turntable")
                app.filming.fps = 2.0
                app.filming.film(app, self.folder / (f"film-{number}.mp4" if number % 2 else f"film-{number}"))
        except Exception as error:  # as the buttons of the page have it
            app.messages.fail("The export cannot be started", error)

    def look(self) -> None:
        app = self.app
        app.set_theme(self.random.choice(THEMES))
        app.interface.scale = self.random.choice(SCALES)
        app.set_backdrop(self.random.choice(("plain", "gradient", "checker")))
        app.resolution.rest_scale = self.random.choice((0.1, 0.25))

    def controller(self) -> None:
        axes = tuple(self.random.uniform(-1, 1) for _ in range(6))
        buttons = tuple(self.random.random() < 0.1 for _ in range(15))
        gamepad = self.random.random() < 0.5
        state = ControllerState("a pad" if gamepad else "SpaceMouse", axes, buttons, gamepad)
        for _ in range(self.random.randrange(1, 6)):
            self.app.controllers.update(self.app, [state], 1 / 60)
            self.ui.frame()

    def wait(self) -> None:
        end = time.monotonic() + 20
        self.ui.frames(60)
        while (self.app.loading is not None or self.app.filming.export is not None) and time.monotonic() < end:
            self.ui.frame()

    def step(self) -> None:
        """One event, and what must hold behind it."""
        (name,) = self.random.choices(list(self.events), [weight for weight, _ in self.events.values()])
        self.events[name][1]()
        self.ui.frame()
        self.done[name] += 1
        if self.ctx.error != "GL_NO_ERROR":
            self.found.append(f"event {self.done.total()}, {name}: an OpenGL error")
        said = [dialog.text + dialog.title for dialog in self.app.messages.dialogs]
        said += [line.text for line in self.app.messages.lines if line.level == "error"]
        for text in said:
            if any(bug in text for bug in BUGS):
                self.found.append(f"event {self.done.total()}, {name}: {text}")
        self.app.messages.lines.clear()
        self.app.quitting = False
        for _ in range(ESCAPES):
            if len(self.app.messages.dialogs) <= 3:
                return
            self.ui.key(imgui.Key.escape)
        self.found.append(f"event {self.done.total()}, {name}: dialogs that Escape does not answer")
        self.close_all()

    def close_all(self) -> None:
        """Everything closed, and a picture of it: where memory is compared."""
        app = self.app
        app.opening.cancel(app)
        app.file_request = app.open_prompt = None
        if app.making.plan is not None:
            app.making.dismiss()
        app.messages.dialogs.clear()
        app.open_packs.packs.clear()
        app.close()
        app.interface.help_shown, app.interface.scale = False, 1.0
        app.interface.reset_layout()
        self.ui.resize(*SIZES[0])
        self.ui.settle()

    def play(self, events: int) -> dict[str, Any]:
        """`events` of them, and what came of it."""
        held = []
        for number in range(1, events + 1):
            self.step()
            if number % ROUND == 0:
                self.close_all()
                held.append(resident())
                said = f"{number} events, {held[-1] / 2**20:.0f} MiB, {len(self.found)} found"
                print(said, file=sys.stderr, flush=True)
        grown = growth(held[WARM_UP:])
        if grown > TOLERATED:
            self.found.append(f"memory grew by {100 * grown:.1f} %: {[round(b / 2**20) for b in held]} MiB")
        return {"events": events, "found": self.found, "grown": grown, "held": held, "done": dict(self.done)}


def growth(held: Sequence[int]) -> float:
    """By how much of it memory grew, from the median of the first third to that of the last; 0 where it was measured less than
    three times.
    """
    third = len(held) // 3
    return median(held[-third:]) / median(held[:third]) - 1 if third else 0.0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--events", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    wanted = parser.parse_args()
    with_steady_memory("tests.viewer.interface.scripted_hour")
    ctx = create_context()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # where files are saved that are given no folder
        hour = Hour(ctx, Path(folder), wanted.seed)
        played = hour.play(wanted.events)
        hour.ui.release()
        os.chdir("/")
    print(json.dumps(played), flush=True)
    return 1 if played["found"] else 0


if __name__ == "__main__":
    sys.exit(main())
