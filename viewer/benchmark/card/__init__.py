"""All figures that a graphics card owes this repository, in one run (docs/card.md).

parts: the frame of a report. drawing: what OpenGL does. children: what other processes do: golden pictures, training.
page: report.json as Markdown. plan: which parts there are.
"""
