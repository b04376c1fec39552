"""Languages of the interface: catalogues are whole, agree with the code, and reach everything that is drawn."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from imgui_bundle import imgui

from baker.baking.config import BakeConfig
from baker.baking.passes import passes_of
from tests.viewer.interface.places import PLACES, WITHOUT_SCENE
from tests.viewer.window.widgets_seen import watch
from viewer.app.application import App
from viewer.core import language
from viewer.core.language import FIELD, LANGUAGES, catalogue, translated
from viewer.features.making.survey import few_with_reasons
from viewer.features.preferences.preferences import apply_preferences, current_preferences

ROOT = Path(__file__).parents[3]
OTHERS = [name for name in LANGUAGES if name != "en"]
PRINTF = re.compile(r"%[-+ #0-9.]*[a-zA-Z%]")
ICONS = re.compile(r"^([\ue000-\uf8ff\s]|\+\s)+|[\ue000-\uf8ff\s]+$")
# What no catalogue has: numbers with their units, keys, names, and what is the same in all languages.
SAME = re.compile(
    r"[\W\d_]*|[\d\W]*(MB|GiB|MiB|fps|ms|dB|px|s|m|cm|mm|in|ft|x|y|z)[\W\d]*|.*\b(Ctrl|Cmd|Num|Num\d|Shift|Alt)\b.*"
    r"|[?WASDEQ ]+( oder F1)?|\d+ (Fotos|写真)|ms +\d+ fps|F\d+|[A-Z?]|-?[xyz]|llvmpipe \(.*|(View|Place) \d+|r_\d+"
    r"|(Space|Tab|Home|Enter|Escape|Backspace|Delete|PageUp|PageDown|Esc)( oder .*)?|snerg|toy.*|English|Deutsch|日本語|\S*/\S*"
    r"|.*\.(png|zip|json|mp4|glb)|inf|test|train|val|\d+ VON \d+|(the file is no pack ?)+|OK|\dK|dB PSNR",
    re.IGNORECASE,
)


@pytest.fixture(autouse=True)
def english_afterwards() -> Iterator[None]:
    yield
    language.use("en")


def test_catalogues_have_the_same_texts_and_none_is_empty() -> None:
    first, *others = (catalogue(name) for name in OTHERS)
    assert all(first.keys() == other.keys() for other in others)
    assert all(text.strip() for name in OTHERS for text in catalogue(name).values())


@pytest.mark.parametrize("name", OTHERS)
def test_fields_and_formats_of_a_translation_are_those_of_the_text(name: str) -> None:
    for english, text in catalogue(name).items():
        count = len(FIELD.findall(english))
        numbers = [int(number or i) for i, number in enumerate(FIELD.findall(text))]
        assert sorted(numbers) == list(range(count)), english
        formats = PRINTF.findall(english) if "%." in english or "%d" in english else []
        assert PRINTF.findall(text) == formats or not formats, english
        assert english.endswith("…") == text.endswith("…"), english


@pytest.mark.parametrize(
    ("english", "german"),
    [("Cancel", "Abbrechen"), ("\uf0c5  Copy##name", "\uf0c5  Kopieren##name"),
     ("\uf030   Picture###page-view", "\uf030   Bild###page-view"), ("+  Keyframe", "+  Schlüsselbild"),
     ("Next  \uf061", "Nächstes  \uf061"),
     ("llvmpipe draws in software: its timer is not reliable.",
      "llvmpipe zeichnet in Software: Der Zeitgeber ist nicht verlässlich."),
     ("Saved a.png", "a.png gespeichert"), ("Writing a.mp4, 3 s left", "a.mp4 wird geschrieben, noch 3 s"),
     ("Play  (P)", "Abspielen  (P)"), ("Paint on surfaces. Esc stops.", "Auf Flächen malen. Esc beendet."),
     ("A film of 4 seconds through 3 views", "Ein Film von 4 Sekunden durch 3 Ansichten"),
     ("Reading the photographs… It needs up to 3 GB of memory and 1 GB on the disk.",
      "Die Fotos werden gelesen… Es braucht bis zu 3 GB Speicher und 1 GB auf der Platte."),
     ("“Undo” failed", "„Rückgängig“ ist fehlgeschlagen"), ("##rail", "##rail"), ("my scene", "my scene"), ("", "")],
)  # fmt: skip
def test_what_is_drawn_is_looked_up_without_icons_and_ids(english: str, german: str) -> None:
    language.use("de")
    assert translated(english) == german
    language.use("fr")
    assert language.current() == "en" and translated(english) == english


def test_names_beyond_the_first_few_are_counted_and_reasons_are_translated() -> None:
    unmatched = dict.fromkeys(("2.jpg", "3.jpg", "4.jpg"), "matches no other")
    reasons = {"0.jpg": "blurred", "1.jpg": "the same as 0.jpg", **unmatched}
    assert few_with_reasons(reasons).endswith("2.jpg (matches no other) and 2 more")
    language.use("de")
    named = "0.jpg (unscharf), 1.jpg (dasselbe wie 0.jpg), 2.jpg (passt zu keinem anderen) und 2 weitere"
    assert few_with_reasons(reasons) == named
    assert named in translated(f"5 photographs are left out: {named}.")


@pytest.mark.parametrize("name", OTHERS)
def test_what_a_scene_in_the_making_is_at_is_translated(name: str) -> None:
    source = "".join(
        file.read_text("utf-8") for folder in ("training", "baker/baking") for file in (ROOT / folder).rglob("*.py")
    )
    titles = {title for title in re.findall(r"(?:progress|stages)\(\"([^\",]+)\"", source)}
    titles |= {title for preset in ("paper", "snerg") for title, _ in passes_of(BakeConfig(preset=preset))}
    assert {"reading photographs", "features", "visibility", "tuning"} <= titles
    language.use(name)
    for title in sorted(titles - {"training"}):
        shown = title[0].upper() + title[1:]
        line = translated(f"{shown}, 40 %   ·   3 min 12 s left")
        assert shown not in line and "left" not in line, line


@pytest.mark.slow
def test_everything_that_the_interface_shows_is_in_the_catalogues(offscreen, scenes) -> None:
    name = "de"  # all catalogues have the same texts
    language.use(name)
    ui, drawn = offscreen(App(), size=(1280, 900)), set()
    with pytest.MonkeyPatch.context() as heard:
        heard.setattr(language, "translated", lambda text: drawn.add(text) or translated(text))
        for place, prepare in PLACES.items():
            ui.app = app = App(canvas=ui.canvas)
            app.interface.language, app.resolution.rest_scale = name, 0.1
            if place not in WITHOUT_SCENE:
                app.show(scenes.pack, scenes.path)
            prepare(app, scenes)
            ui.settle(60)
        for tool in ("line", "angle", "point", "scale", "ground", "origin"):
            ui.app.measure_tool.choose(ui.app, tool)
            ui.app.interface.page = "move" if tool in ("ground", "origin") else "measure"
            ui.frames(3)
    values = {text.casefold() for text in catalogue(name).values()} | {text.casefold() for text in catalogue(name)}
    filled = [language._pattern(text) for text in catalogue(name).values() if FIELD.search(text)]
    drawn = {text for text in drawn if not any(pattern.fullmatch(text) for pattern in filled)}  # looked up before
    left = set()
    for text in drawn:
        shown = PRINTF.sub("", ICONS.sub("", text.split("##")[0])).strip()
        translated_already = shown.casefold() in values or shown.endswith("…") or not shown.isascii()
        if translated(text) == text and not translated_already and not SAME.fullmatch(shown):
            left.add(shown)
    assert not left, "\n".join(sorted(left))


@pytest.mark.parametrize("name", OTHERS)
def test_the_words_of_a_button_fit_into_it(offscreen, scenes, name: str) -> None:
    ui, cut_off = offscreen(App(), size=(900, 640)), []
    with watch() as seen:
        for place in ("view", "film", "export a page", "question", "make a scene", "review"):
            ui.app = app = App(canvas=ui.canvas)
            app.interface.language, app.resolution.rest_scale = name, 0.1
            app.show(scenes.pack, scenes.path)
            PLACES[place](app, scenes)
            ui.settle(40)
            imgui.set_current_context(ui.ui.context)
            buttons = [each for each in seen.seen.values() if each.kind == "button"]
            widths = [imgui.calc_text_size(each.label, hide_text_after_double_hash=True).x for each in buttons]
            cut_off += [e.label for e, wide in zip(buttons, widths, strict=True) if wide > e.rect[2] - e.rect[0]]
    assert not cut_off


def test_the_language_is_switched_while_running_and_remembered(offscreen, app, pack) -> None:
    app.interface.page = "settings"
    ui = offscreen(app, pack)
    apply_preferences(app, {"language": "de", "page": "settings"})
    ui.settle()
    assert language.current() == "de" and current_preferences(app)["language"] == "de"
    app.interface.language = "en"
    ui.settle()
    assert language.current() == "en"
