"""snerg-view in which something is being made already: python making_viewer.py FOLDER, for making/fake_make.py."""

import sys
from pathlib import Path
from typing import Any, cast

from viewer.commands import view
from viewer.features.making.make_plan import Plan

FAKE = Path(__file__).parents[1] / "features" / "making" / "fake_make.py"


def main(folder: Path) -> int:
    cast(Any, Plan).command = lambda plan: [sys.executable, str(FAKE), "wait", str(folder)]
    start = view.apply_preferences

    def use(app, preferences) -> None:
        start(app, preferences)
        app.making.plan = Plan("scene", folder / "photographs", folder)
        app.making.start(app)

    view.apply_preferences = use
    return view.main([])


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
