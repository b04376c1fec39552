"""What a person may be shown: one line, of characters that neither move a cursor nor turn a text around."""

LONGEST_REFUSAL = 700  # characters; some 500 and the path of a temporary folder


class Unfit(Exception):
    """Words that nobody should be shown."""


def require_words(text: str, longest: int = LONGEST_REFUSAL) -> None:
    """Unfit where `text` is too long, of several lines, or holds control characters."""
    if len(text) > longest:
        raise Unfit(f"{len(text)} characters")
    if not text.isprintable():
        bad = next(c for c in text if not c.isprintable())
        raise Unfit(f"the character U+{ord(bad):04X}")
