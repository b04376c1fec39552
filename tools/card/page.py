"""report.json as a page that can be read: what was measured on which card, and what was not, with the reason."""

from collections.abc import Iterator, Mapping
from typing import Any

from baker.reports.pages import markdown_table, number

Facts = Mapping[str, Any]


def page(report: Facts) -> str:
    """Markdown of a report (tools.card.parts.run_parts); pictures are named as they lie beside it."""
    parts: Mapping[str, Facts] = report["parts"]
    device = parts.get("device", {})
    blocks = [f"# Figures of {_card(device)}", *_device(device), *_state(parts)]
    packs = {name.removeprefix("pack "): facts for name, facts in parts.items() if name.startswith("pack ")}
    blocks += [*_packs(packs), *_golden(parts.get("golden pictures", {}))]
    for name, facts in parts.items():
        if name.startswith(("curve of ", "step of ")):
            blocks += _training(name, facts)
    return "\n\n".join(blocks) + "\n"


def _card(device: Facts) -> str:
    return device.get("card", {}).get("name") or device.get("renderer") or "an unknown card"


def _yes(holds: bool) -> str:
    return "yes" if holds else "**no**"


def _device(device: Facts) -> Iterator[str]:
    card = device.get("card", {})
    known = {
        "OpenGL": " · ".join(str(device[key]) for key in ("renderer", "opengl") if key in device),
        "driver": card.get("driver"),
        "memory": f"{card['bytes'] / 2**30:.1f} GiB" if "bytes" in card else None,
        "power": f"{card['watts_allowed']:.0f} W allowed" if "watts_allowed" in card else None,
        "power at rest": f"{device['idle_watts']:.1f} W" if device.get("idle_watts") else None,
        "clock of frame times": device.get("timer"),
        "system": f"{device['system']}, {device['cores']} cores" if "system" in device else None,
        "Python": device.get("python"),
        "packages": ", ".join(f"{name} {number}" for name, number in device.get("packages", {}).items()),
    }
    yield "\n".join(f"- {name}: {value}" for name, value in known.items() if value)
    if device.get("software"):
        yield "**This is a software rasteriser, not a graphics card.** Only ratios mean anything."


def _state(parts: Mapping[str, Facts]) -> Iterator[str]:
    yield "## What was done"
    rows = [(name, facts["status"], facts["why"] or " ", f"{facts['seconds']:.0f}") for name, facts in parts.items()]
    yield markdown_table(("part", "", "why", "seconds"), rows)


def _packs(packs: Mapping[str, Facts]) -> Iterator[str]:
    done = {name: facts for name, facts in packs.items() if "times" in facts}
    if not done:
        return
    yield "## Frame times"
    some = next(iter(done.values()))
    yield (
        f"{some['width']} × {some['height']}, {some['times']['frames']} frames of the paper's camera path, `exact` and `paper` "
        f"alternating; {some['times']['clock']}; medians. The ratio's range holds 90 % of the pairs of frames."
    )
    rows = []
    for name, facts in done.items():
        times, exact = facts["times"], facts["power"]["exact"]
        ratio = f"**{times['ratio']:.2f}** ({times['ratio_p5']:.2f} – {times['ratio_p95']:.2f})"
        rows.append((
            name, " × ".join(map(str, facts["voxels"])),
            number(times["exact"]["ms_p50"], 3), number(times["paper"]["ms_p50"], 3), ratio,
            number(exact["fps"], 0), number(exact["watts"], 1), number(exact["fps_per_watt"]),
            number(facts["power"]["paper"]["fps_per_watt"]), number(times["exact"]["gpu_bytes"] / 2**20, 0),
        ))  # fmt: skip
    headings = "pack, voxels, `exact` (ms), `paper` (ms), ratio, FPS without pause, W, FPS/W, `paper` FPS/W, MiB"
    yield markdown_table(headings.split(", "), rows)
    yield "The same frames by both clocks, medians in milliseconds:"
    clocks = [
        (name, number(f["timer"]["gpu_ms_p50"], 3), number(f["timer"]["wall_ms_p50"], 3)) for name, f in done.items()
    ]
    yield markdown_table(("pack", "timer query", "wall, around finish()"), clocks)
    yield "## Exactness"
    yield (
        "`exact` against taking every sample. Allowed: 0.1 % of channels beyond 1/255, at most 4/255 "
        '(docs/rendering.md, "Marchers").'
    )
    checks = []
    for name, facts in done.items():
        found = facts["exactness"]
        share, psnr = f"{100 * found['beyond']:.4f} %", number(found["psnr"], 1)
        checks.append((name, _yes(found["holds"]), number(found["worst"]), share, psnr))
    yield markdown_table(("pack", "holds", "worst, of 255", "beyond 1/255", "PSNR (dB)"), checks)
    yield "\n".join(f"![{name}]({facts['picture']})" for name, facts in done.items())


def _golden(golden: Facts) -> Iterator[str]:
    if "pictures" not in golden:
        return
    tolerance, pictures = golden["tolerance"], golden["pictures"]
    yield "## Golden pictures"
    yield (
        f"Tolerance on this renderer: a mean difference of {tolerance['mean']}/255, and {100 * tolerance['share']:.1f} % "
        f"of channels beyond {tolerance['channel']}/255. The pictures were made on llvmpipe."
    )
    rows = [
        (name, _yes(p["within"]), number(p["mean"], 3), f"{100 * p['share']:.3f} %", number(p["worst"], 0))
        for name, p in pictures.items()
    ]
    yield markdown_table(("picture", "within", "mean", f"beyond {tolerance['channel']}/255", "worst"), rows)


def _training(name: str, facts: Facts) -> Iterator[str]:
    if facts["status"] == "skipped":
        return
    yield f"## {name[:1].upper()}{name[1:]}"
    if facts["status"] == "failed":
        yield f"**Failed:** {facts['why']}"
    if "command" in facts:
        yield f"    python {' '.join(['-m', *facts['command']])}"
    if facts.get("step_ms") and "steps" in facts:
        yield (
            f"{facts['steps']:,} steps. One step takes **{facts['step_ms']:.1f} ms**: {number(facts['rays_per_second'], 0)} "
            f"rays a second, {number(facts.get('samples_per_second'), 0)} samples a second (medians of the later half)."
        )
    if facts.get("curve"):
        rows = [(f"{p['step']:,}", number(p["minutes"]), number(p["psnr"])) for p in facts["curve"]]
        yield markdown_table(("step", "minutes", "PSNR held out (dB)"), rows)
    if isinstance(facts.get("parts"), Mapping):
        yield f"One step takes {facts['step_ms']:.1f} ms; medians of {facts['rounds']} rounds."
        rows = [(part, f"{100 * p['share']:.0f} %", number(p["ms"])) for part, p in facts["parts"].items()]
        yield markdown_table(("part", "share", "ms"), rows)
    if "picture" in facts:
        yield f"![{name}]({facts['picture']})"
