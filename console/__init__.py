"""How every command talks to a person: one clear line for bad input, exit status, progress.

It imports no other package of ours, so that the pack, the trainer and the viewer, which may not import
one another, still fail and report in the same voice.
"""

from console.command_line import check_results, run_command, write_json, write_result
from console.errors import Notice, UserError, collect_notices, not_written, notify, refusal
from console.progress import Progress, progress
