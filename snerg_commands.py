"""Where the console scripts begin. Nothing is imported here, so that Ctrl-C while all else is being imported is one line, too.

Python itself answers Ctrl-C with a traceback; console.run_command, which does not, takes a moment to arrive.
"""

import sys
from importlib import import_module

INTERRUPTED = 130


def _run(module: str, command: str) -> int:
    try:
        main = import_module(module).main
    except KeyboardInterrupt:
        print(f"{command}: interrupted", file=sys.stderr)
        return INTERRUPTED
    return main()


def make() -> int:
    return _run("baker.commands.make", "snerg-make")


def train() -> int:
    return _run("training.commands.train", "snerg-train")


def bake() -> int:
    return _run("baker.commands.bake", "snerg-bake")


def evaluate() -> int:
    return _run("baker.commands.evaluate", "snerg-eval")


def render() -> int:
    return _run("viewer.commands.render", "snerg-render")


def bench() -> int:
    return _run("viewer.commands.bench", "snerg-bench")


def view() -> int:
    return _run("viewer.commands.view", "snerg-view")


def pack() -> int:
    return _run("baker.commands.pack", "snerg-pack")
