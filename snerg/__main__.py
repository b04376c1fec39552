"""`python -m snerg COMMAND …`: the commands, where no console scripts are on the PATH."""

import sys
from pathlib import Path

ROOT = str(Path(__file__).resolve().parents[1])
USAGE = "usage: python -m snerg {%s} …\n\npython -m snerg COMMAND --help tells its options."


def main() -> int:
    """Runs the command that the first word names; returns its exit status."""
    if not sys.flags.safe_path and str(Path(sys.path[0]).resolve()) != ROOT:
        del sys.path[0]  # the current folder: a training.py of the user's there is none of ours
    import snerg_commands

    names = [name.removeprefix("snerg-") for name in snerg_commands.MODULES]
    words = sys.argv[1:]
    if not words or words[0] in ("-h", "--help"):
        print(USAGE % ",".join(names))
        return 0 if words else 2
    if words[0] not in names:
        print(f"snerg: no such command: {words[0]}; there are {', '.join(names)}", file=sys.stderr)
        return 2
    del sys.argv[1]
    return snerg_commands.run(f"snerg-{words[0]}")


if __name__ == "__main__":
    sys.exit(main())
