"""What the documents name is there: links, anchors, pictures, paths, modules, commands, options, values, the tree."""

import json
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from pkgutil import resolve_name

import pytest
from PIL import Image

from snerg_commands import MODULES
from viewer.features.film.picture_export import PICTURE
from viewer.rendering.settings import MODES

ROOT = Path(__file__).parents[1]
BESIDE = ("README.md", "CONTRIBUTING.md", "SECURITY.md", "CHANGELOG.md", "CODE_OF_CONDUCT.md")
DOCUMENTS = [*(ROOT / name for name in BESIDE), *sorted(ROOT.glob("docs/*.md"))]
PACKAGES = ("console", "scenepack", "training", "baker", "viewer", "snerg", "tools")
FOLDERS = (*PACKAGES, "shaders", "scripts", "tests", "docs", ".ci", ".github")
OF_USERS = ("snerg/make.log", "snerg/marks")  # in folders of theirs
MADE_LATER = {".venv", "_src", "out", "build", "dist", "failures"}  # by running things; .gitignore has them
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
OF_ALL = {"--debug", "--tyro-print-completion"}  # which no --help lists
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9]*(?:[.-][a-z0-9]+)*")
PROGRAM = re.compile(r"python -m ([\w.]+)|(?<![\w-])(snerg-[a-z]+)")
pytestmark = pytest.mark.documents


each_document = pytest.mark.parametrize("document", DOCUMENTS, ids=lambda document: document.name)


@cache
def text_of(document: Path) -> str:
    return document.read_text(encoding="utf-8")


@cache
def prose_of(document: Path) -> str:
    """Its text without fenced blocks."""
    return re.sub(r"^ *```.*?^ *```", "", text_of(document), flags=re.M | re.S)


def blocks_of(document: Path) -> list[str]:
    """Code blocks, fenced or indented, without the language."""
    fenced = re.findall(r"^ *```\w*\n(.*?)^ *```", text_of(document), re.M | re.S)
    return fenced + re.findall(r"(?:^(?: {4}| {6,}).*\n)+", prose_of(document), re.M)


def spans_of(document: Path) -> list[str]:
    """Code within lines, `like this`."""
    return [span.replace("\\|", "|").replace("\n", " ") for span in re.findall(r"`([^`]+)`", prose_of(document))]


def links_of(document: Path) -> list[str]:
    return re.findall(r"\]\(([^)\s]+)\)", prose_of(document))


@cache
def anchors_of(document: Path) -> set[str]:
    """The anchors of its headings, as code forges make them."""
    return {anchor_of(title) for title in re.findall(r"^#+ (.+)$", prose_of(document), re.M)}


def anchor_of(title: str) -> str:
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


@cache
def options() -> dict[str, dict[str, dict]]:
    """The options of all programs, from their --help; see tests.list_options."""
    named = {name for document in DOCUMENTS for name in re.findall(r"python -m ([\w.]+)", text_of(document))}
    names = {*MODULES.values(), *(name for name in named if name.split(".")[0] in PACKAGES and name != "snerg")}
    words = [sys.executable, "-m", "tests.list_options", *sorted(names)]
    asked = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert asked.returncode == 0, asked.stderr
    return json.loads(asked.stdout)


def commands_in(line: str) -> Iterator[tuple[list[str], str]]:
    """Each of our programs in a line, with the words after it: ["snerg-pack info", "snerg-pack check"], " PACK"."""
    line = re.sub(r"python -m snerg(?: (\w+))?", lambda found: f"snerg-{found[1]}" if found[1] else "", line)
    starts = list(PROGRAM.finditer(line))
    for start, end in zip(starts, [*[found.start() for found in starts[1:]], len(line)], strict=False):
        name, words = start[0], line[start.end() : end]
        known = [command for command in options() if command.startswith(f"{name} ")]
        if known:
            subcommands = re.match(r" ([a-z]+(?:\|[a-z]+)*)(?![\w-])", words)
            yield ([f"{name} {word}" for word in subcommands[1].split("|")] if subcommands else known), words
        else:
            yield [name], words


def wrong_options(commands: list[str], words: str) -> list[str]:
    """Complaints about the options in `words`, of which one of the commands must know each, and about their values."""
    unknown = [command for command in commands if command not in options()]
    if unknown:
        return [f"no such command: {unknown}"]
    wrong = []
    for found in OPTION.finditer(words):
        known = [options()[command][found[0]] for command in commands if found[0] in options()[command]]
        if not known and found[0] not in OF_ALL:
            wrong.append(f"{' / '.join(commands)} has no {found[0]}")
        value = re.match(r"[ =]([a-z][\w-]*(?: ?\| ?[a-z][\w-]*)*)", words[found.end() :])
        choices = {choice for option in known for choice in option["choices"]} - {"None"}
        if value and choices and not set(re.split(r" ?\| ?", value[1])) <= choices:
            wrong.append(f"{commands[0]} {found[0]} takes no {value[1]}, but {sorted(choices)}")
    return wrong


@each_document
def test_links_lead_somewhere(document: Path) -> None:
    for link in links_of(document):
        if "://" in link:
            assert link.startswith("https://"), link
            continue
        name, _, anchor = link.partition("#")
        target = (document.parent / name).resolve() if name else document
        assert target.exists() and target.is_relative_to(ROOT), f"{document.name}: {link}"
        if anchor:
            assert anchor in anchors_of(target), f"{document.name}: {link}; there are {sorted(anchors_of(target))}"


def test_every_picture_is_whole_and_shown_somewhere() -> None:
    shown = {(document.parent / link).resolve() for document in DOCUMENTS for link in links_of(document)}
    kept = {path for path in (ROOT / "docs/pictures").iterdir() if not path.name.startswith(".")}
    assert kept and kept <= shown, f"shown nowhere: {sorted(path.name for path in kept - shown)}"
    for path in kept:
        if path.suffix in (".png", ".jpg"):
            with Image.open(path, formats=["PNG", "JPEG"]) as picture:
                picture.load()
                assert min(picture.size) >= 100, path


@each_document
def test_paths_lead_somewhere(document: Path) -> None:
    for span in [*spans_of(document), *blocks_of(document)]:
        for name in re.findall(rf"(?<![\w/.])(?:{'|'.join(map(re.escape, FOLDERS))})/[\w./*-]*", span):
            path = name.rstrip(".")
            if name in OF_USERS or set(Path(path).parts) & MADE_LATER or re.search(r"/[A-Z]", path):
                continue
            assert list(ROOT.glob(path)) if "*" in path else (ROOT / path).exists(), f"{document.name}: {name}"


@each_document
def test_dotted_names_are_modules_or_what_they_define(document: Path) -> None:
    for span in [*spans_of(document), *blocks_of(document)]:
        for name in re.findall(rf"(?<![\w/.])(?:{'|'.join(PACKAGES)})(?:\.[A-Za-z_]\w*)+(?![\w/])", span):
            if name.endswith((".md", ".json", ".log", ".zip")):  # viewer.json is a file of settings
                continue
            resolve_name(name)  # ImportError or AttributeError where nothing has this name


@each_document
def test_commands_in_blocks_have_these_options(document: Path) -> None:
    wrong = []
    for block in blocks_of(document):
        commands: list[str] = []
        for line in block.splitlines():
            line = re.sub(r"(^|\s)#.*", "", line)
            if list(PROGRAM.finditer(line)):
                for commands, words in commands_in(line):
                    wrong += wrong_options(commands, words)
            elif commands and re.match(r"\s+[\[(-]", line):  # the line before goes on
                wrong += wrong_options(commands, line)
            else:
                commands = []
    assert not wrong, f"{document.name}: {wrong}"


@each_document
def test_commands_and_options_in_prose_exist(document: Path) -> None:
    ours = {name for command in options().values() for name in command} | OF_ALL
    ours |= set(re.findall(r'"(--[\w-]+)"', text_of(ROOT / "tests/conftest.py")))
    wrong = []
    for span in spans_of(document):
        if PROGRAM.search(span):
            wrong += [line for commands, words in commands_in(span) for line in wrong_options(commands, words)]
        elif span.startswith("--"):
            wrong += [f"nothing has {name}" for name in OPTION.findall(span) if name not in ours]
    assert not wrong, f"{document.name}: {wrong}"


@each_document
def test_make_targets_and_extras_exist(document: Path) -> None:
    targets = set(re.findall(r"^([\w-]+):(?!=)", text_of(ROOT / "Makefile"), re.M))
    for span in [*spans_of(document), *blocks_of(document)]:
        for target in re.findall(r"^\s*make ([a-z][\w-]*)", span, re.M):
            assert target in targets, f"{document.name}: make {target}"
        for extra in re.findall(r"pip install '?\.\[(\w[\w,-]*)\]", span):
            assert set(extra.split(",")) <= set(PROJECT["optional-dependencies"]), f"{document.name}: {extra}"


@each_document
def test_variables_of_the_environment_are_read_somewhere(document: Path) -> None:
    code = "".join(text_of(path) for folder in (*PACKAGES, "tests") for path in (ROOT / folder).rglob("*.py"))
    for name in set(re.findall(r"\bSNERG_[A-Z_]+\b", text_of(document))):
        assert f'"{name}"' in code, f"{document.name}: {name}"


def test_code_cites_documents_and_sections_that_exist() -> None:
    """As in `docs/format.md, "Untidy packs"`; and no other document than those of this repository."""
    files = [path for folder in (*PACKAGES, "tests", "shaders") for path in (ROOT / folder).rglob("*.*")]
    cited = 0
    for path in files:
        if path.suffix not in (".py", ".glsl", ".vert", ".frag") or path == Path(__file__):
            continue
        for name, title in re.findall(r'\b(docs/[\w-]+\.md)(?:,? \(?"([^"]+)")?', text_of(path)):
            cited += 1
            assert (ROOT / name).is_file(), f"{path.relative_to(ROOT)} cites {name}"
            assert not title or anchor_of(title) in anchors_of(ROOT / name), f"{path} cites {name}, {title!r}"
    assert cited > 30


def table_below(document: Path, heading: str) -> list[list[str]]:
    """The cells of the first table below a heading, without its head."""
    part = text_of(document).split(f"# {heading}\n", 1)[1]
    rows = re.search(r"(?:^\|.*\n)+", part, re.M)
    assert rows is not None, heading
    cells = [re.split(r"(?<!\\)\|", row.strip("|\n")) for row in rows[0].splitlines()[2:]]
    return [[cell.strip() for cell in row] for row in cells]


def names_in(cells: list[str]) -> set[str]:
    return {name for cell in cells for name in re.findall(r"`([^`]+)`", cell)}


def test_tables_list_all_choices_and_true_defaults() -> None:
    commands, rendering, packs = (ROOT / f"docs/{name}.md" for name in ("commands", "rendering", "format"))
    known = options()
    for name, default, _ in table_below(commands, "snerg-bake"):
        option = known["snerg-bake"][name.strip("`")]
        assert option["default"] == ("None" if default == "automatic" else default), name
    for document, heading, choices in (
        (commands, "snerg-train", known["snerg-train"]["--preset"]["choices"]),
        (rendering, "Display modes", [PICTURE, *MODES]),
        (rendering, "Marchers", known["snerg-render"]["--marcher"]["choices"]),
        (packs, "Other codecs", known["snerg-bake"]["--codec"]["choices"]),
    ):
        assert names_in([row[0] for row in table_below(document, heading)]) == set(choices), heading


def test_the_format_lists_the_keys_that_are_written() -> None:
    with zipfile.ZipFile(ROOT / "viewer/demo/demo.zip") as pack:
        written = set(json.loads(pack.read("scene_params.json")))
    listed = names_in([row[0] for row in table_below(ROOT / "docs/format.md", "scene_params.json")])
    assert written == listed


def test_the_manual_names_what_the_window_shows() -> None:
    """Words *like this* are titles of pages, buttons and switches, or values of theirs."""
    code = "".join(text_of(path) for folder in ("viewer", "training") for path in (ROOT / folder).rglob("*.py"))
    titles = set(re.findall(r"(?<![*\w])\*([A-Z0-9][^*\n]+)\*(?!\*)", text_of(ROOT / "docs/viewer.md")))
    assert len(titles) > 15
    assert not {title for title in titles if title not in code and title.lower() not in code}


def test_the_tree_is_the_tree_on_disk() -> None:
    tree = next(block for block in blocks_of(ROOT / "docs/architecture.md") if block.startswith("console/"))
    listed: set[str] = set()
    above: list[str] = []
    for line in tree.splitlines():
        depth = (len(line) - len(line.lstrip())) // 2
        above = [*above[:depth], line.split()[0].rstrip("/")]
        listed.add("/".join(above))
    on_disk = folders_on_disk()
    tests = {path for path in on_disk if path.startswith("tests/")}
    own = {path for path in tests if path.split("/")[1] in ("data", "fuzz", "golden")}
    assert {path.removeprefix("tests/") for path in tests - own} <= on_disk, "a folder of tests for no folder of code"
    assert not listed ^ (on_disk - tests | {"tests/data", "tests/fuzz", "tests/golden"})


def folders_on_disk() -> set[str]:
    """Folders below the top that hold files of ours at any depth, without what is made later or hidden."""
    found = set()
    for path in ROOT.rglob("*"):
        parts = path.relative_to(ROOT).parts
        hidden = any(part.startswith((".", "__")) or part.endswith(".egg-info") for part in parts[:-1])
        if path.is_file() and not hidden and not set(parts) & MADE_LATER and parts[0] in FOLDERS:
            found |= {"/".join(parts[:i]) for i in range(1, len(parts))}
    return found


def test_the_pages_are_what_their_figures_give() -> None:
    assert subprocess.run([sys.executable, "scripts/results.py", "--check"], cwd=ROOT).returncode == 0, "make results"


def test_every_figure_of_the_files_is_on_the_page_and_each_file_says_how_it_was_made() -> None:
    template = (ROOT / "docs/results/page.md").read_text(encoding="utf-8")
    for path in sorted((ROOT / "docs/results").glob("*.json")):
        file = json.loads(path.read_text(encoding="utf-8"))
        assert file["commands"] and file["commit"] and file["device"], path
        for key in file["figures"]:
            assert f"{{{{{path.stem}.{key}" in template, f"{path.name}: {key}"
        for key, table in file.get("tables", {}).items():
            assert f"{{{{{path.stem}.table:{key}}}}}" in template, f"{path.name}: {key}"
            assert {len(row) for row in table["rows"]} == {len(table["columns"])} == {len(table["formats"])}, key
