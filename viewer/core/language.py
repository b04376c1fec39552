"""The language of the interface: one catalogue for each besides English, which is what the code says.

A catalogue is JSON: English text to its translation. `{}` stands for what is filled in, in the same order; `{0}`, `{1}` where a
translation needs another order. viewer.interface.ui looks up each text before it is drawn. A text that no catalogue has, such
as a pack's name or a reader's complaint, is not translated.
"""

import json
import re
from functools import lru_cache
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "interface" / "languages"
LANGUAGES = {"en": "English", "de": "Deutsch", "ja": "日本語"}
LETTERS = {"ja": "あ漢"}  # that a font must have
FIELD = re.compile(r"\{(\d*)\}")
_ICONS_BEFORE = re.compile(r"^([\ue000-\uf8ff\s]|\+\s)*")  # that of a plus is a plus
_ICONS_AFTER = re.compile(r"[\ue000-\uf8ff\s]*$")
_SENTENCES = re.compile(r"(?<=[.:!?…]) +")

_language = "en"
_exact: dict[str, str] = {}
_templates: list[tuple[re.Pattern[str], str]] = []


def catalogue(language: str) -> dict[str, str]:
    """English text to its translation; nothing of English itself."""
    file = FOLDER / f"{language}.json"
    return json.loads(file.read_text(encoding="utf-8")) if language != "en" else {}


def use(language: str) -> None:
    """Draws in another language from now on. An unknown one is English."""
    global _language, _exact, _templates
    _language = language if language in LANGUAGES else "en"
    texts = catalogue(_language)
    _exact = {english: text for english, text in texts.items() if not FIELD.search(english)}
    longest = sorted((english for english in texts if FIELD.search(english)), key=len, reverse=True)
    _templates = [(_pattern(english), texts[english]) for english in longest]
    translated.cache_clear()


def current() -> str:
    return _language


def _pattern(english: str) -> re.Pattern[str]:
    return re.compile("(.+?)".join(map(re.escape, FIELD.sub("\0", english).split("\0"))), re.DOTALL)


@lru_cache(maxsize=4096)
def translated(text: str) -> str:
    """What is drawn instead of an English text; what stands behind ## (imgui's ids), and icons around it, stay."""
    if not _exact:
        return text
    shown, mark, name = text.partition("##")
    start = len(shown) - len(_ICONS_BEFORE.sub("", shown))
    body = _ICONS_AFTER.sub("", shown[start:])
    parts = _SENTENCES.split(body) if "  (" not in body else body.split("  (", 1)  # sentences, or a title and its keys
    found, known = _exact.get(body), [_found(part) for part in parts]
    if found is None and (len(parts) == 1 or None in known):
        found = _found(body)
    if found is None:
        if not any(known):
            return text
        joint = "  (" if "  (" in body else "" if _language == "ja" else " "
        found = joint.join(part if other is None else other for part, other in zip(parts, known, strict=True))
    return shown[:start] + found + shown[start + len(body) :] + mark + name


def _found(text: str) -> str | None:
    if text in _exact:
        return _exact[text]
    for pattern, translation in _templates:
        match = pattern.fullmatch(text)
        if match is not None:
            return translation.format(*(_found(field) or field for field in match.groups()))
    return None
