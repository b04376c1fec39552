"""What a command writes for people, without its progress."""

import re

_PROGRESS = re.compile(r"[^:]+: \d+ %  \d")  # "comparing: 100 %  4 s": printed where work takes more than two seconds


def without_progress(stderr: str) -> list[str]:
    """The lines of `stderr` but those of progress, which a slow machine prints and a fast one does not."""
    return [line for line in stderr.splitlines() if line and not _PROGRESS.match(line)]
