"""Hooks of mkdocs: documents beside docs/ become pages, links to code plain text, and the demo scene a page of its own.

The texts are written for readers of the repository; nothing of them is copied by hand.
"""

import posixpath
import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
# Their pages; mkdocs would take README.md for the index of its folder.
BESIDE = {"README.md": "start.md"} | {
    f"{name}.md": f"{name}.md" for name in ("CONTRIBUTING", "CHANGELOG", "SECURITY", "CODE_OF_CONDUCT")
}
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Adds the documents beside docs/, and the page of the demo scene."""
    for name, page_name in BESIDE.items():
        files.append(File.generated(config, page_name, content=(ROOT / name).read_text(encoding="utf-8")))
    sys.path.insert(0, str(ROOT))
    import snerg

    with snerg.load(snerg.demo()) as scene:
        page = Path(config.site_dir).parent / "demo.html"
        scene.save(page, title="snerg: the demo scene")
    files.append(File.generated(config, "demo.html", content=page.read_bytes()))
    return files


def on_page_markdown(markdown: str, page: Any, files: Files, **_: Any) -> str:
    """Links between documents lead to their pages; what is no page is named."""
    folder = "" if page.file.src_uri in BESIDE.values() else "docs"

    def lead(link: re.Match[str]) -> str:
        mark, text, target = link.groups()
        if "://" in target or target.startswith(("#", "mailto:")):
            return link[0]
        path, _, anchor = target.partition("#")
        there = posixpath.normpath(posixpath.join(folder, path)).removeprefix("docs/")
        there = BESIDE.get(there, there)
        if files.get_file_from_path(there) is None:
            return text
        return f"{mark}[{text}]({there}{'#' + anchor if anchor else ''})"

    return LINK.sub(lead, markdown)
