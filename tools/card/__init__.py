"""All figures of a graphics card, in one run: `python -m tools.card --out DIR` (docs/card.md).

parts: a report in parts. opengl: exactness and frame times. subprocesses: golden pictures and training. page: report.json as
Markdown. __main__: the command, and which parts there are.
"""
