"""Words in the sentences that people read: counts, lists, stamps, durations, names."""

import re
import textwrap
from collections.abc import Collection, Iterable

# Of a longer list only the first are named; fewer if they are quoted.
_NAMED = 8
_QUOTED = 5

# Counting letters takes a microsecond a name, comparing whole names ten and more: of more names
# only the likely ones are.
_MOST_COUNTED = 1000
_MOST_COMPARED = 64

# Python reads no number of more than 4,300 digits.
_DIGITS = r"([0-9]{1,1000})"


def counted(count: int, noun: str) -> str:
    """A number of things: `1 frame`, `2 frames`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def natural_order(name: str) -> tuple[object, ...]:
    """The key by which lists of names are sorted: numbers count as such, robot2 before robot10."""
    parts = re.split(_DIGITS, name)
    return tuple(int(part) if at % 2 else part for at, part in enumerate(parts)), name


def listed(words: Collection[str], *, most: int = _NAMED) -> str:
    """The words with commas, at most `most` of them: `a, b and 3 more`."""
    named = ", ".join(list(words)[:most])
    return " ".join(filter(None, (named, and_more(len(words), most))))


def and_more(count: int, most: int) -> str:
    """The end of a list of which only `most` are named: `and 3 more`; "" if all are."""
    return f"and {count - most} more" if count > most else ""


def quoted(names: Collection[str]) -> str:
    """The first five names, quoted, and how many more there are: `'arm', 'leg' and 3 more`."""
    return listed([repr(name) for name in names], most=_QUOTED)


def printable(text: str, most: int = 200) -> str:
    """Text that another program wrote, safe in a log, a table and a terminal.

    Control characters, marks of direction and lone surrogates come as escapes (`\\x1b`), and the
    end of a text of more than `most` letters as an ellipsis. `repr` of a text escapes the same, but
    does not cut.
    """
    if len(text) > most:
        text = f"{text[: most - 1]}…"
    if text.isprintable():
        return text
    return "".join([char if char.isprintable() else repr(char)[1:-1] for char in text])


def columns(text: str) -> int:
    """How many columns of a terminal a text takes: wide letters and emoji two, accents none."""
    if text.isascii():
        return len(text)
    return sum(map(_columns_of, text))


def cut(text: str, most: int) -> str:
    """The text in at most `most` columns of a terminal; if it is cut, it ends in an ellipsis."""
    return text if columns(text) <= most else f"{_fitting(text, most - 1)}…"


def cut_middle(text: str, most: int) -> str:
    """As `cut`, with the ellipsis in the middle: names that begin alike often end differently."""
    if columns(text) <= most:
        return text
    end = _end(text, (most - 1) // 2)
    return f"{_fitting(text, most - 1 - columns(end))}…{end}"


def cut_start(text: str, most: int) -> str:
    """As `cut`, with the ellipsis at the start."""
    if columns(text) <= most:
        return text
    return f"…{_end(text, most - 1)}"


def cut_apart(texts: Iterable[str], most: int) -> dict[str, str]:
    """Each text in at most `most` columns, so that different ones stay different: all are cut in
    the middle, or all at the start, or at the end. If that is not enough, they are longer.
    """
    all_texts = set(texts)
    longest = max(map(columns, all_texts), default=0)
    while most < longest:
        for cutting in (cut_middle, cut_start, cut):
            found = {text: cutting(text, most) for text in all_texts}
            if len(set(found.values())) == len(all_texts):
                return found
        most += max((longest - most) // 4, 1)
    return {text: text for text in all_texts}


def wrapped(
    text: str, longest: int, lead: str = "", after: str | None = None, *, break_words: bool = True
) -> list[str]:
    """The text in lines of at most `longest` letters; no break at `-`, since an option is one word.

    The first line begins with `lead`, each further one with `after` (None: as many spaces as `lead`
    has letters). Without `break_words` a word that is longer has a line of its own.
    """
    return textwrap.wrap(
        text,
        longest,
        initial_indent=lead,
        subsequent_indent=" " * len(lead) if after is None else after,
        break_long_words=break_words,
        break_on_hyphens=False,
    )


def _end(text: str, room: int) -> str:
    """The end of a text that fits into this many columns."""
    end = _fitting(text[::-1], room)[::-1]
    while end and not _columns_of(end[0]):
        end = end[1:]  # an accent whose letter is cut away
    return end


def _fitting(text: str, room: int) -> str:
    """The beginning of a text that fits into this many columns."""
    kept = []
    for letter in text:
        room -= _columns_of(letter)
        if room < 0:
            break
        kept.append(letter)
    return "".join(kept)


def _columns_of(letter: str) -> int:
    # Every process imports this module, and few print a table.
    import unicodedata

    if unicodedata.category(letter) in ("Mn", "Me"):
        return 0
    return 2 if unicodedata.east_asian_width(letter) in "WF" else 1


# Longer ones come from a mistake or an attack: they would fill screens, messages and memory.
MOST_LETTERS = 255


def mistake_in(name: object) -> str:
    """Why this cannot be the name of a frame, as the end of a sentence that begins with the kind of
    the name; "" if it can.
    """
    if not isinstance(name, str):
        return f"must be a str such as 'base_link', not {type(name).__name__}"
    if name.isprintable() and 0 < len(name) <= MOST_LETTERS and name[0] != "/":
        return ""  # nearly all, and each transform that is made asks for two
    if not name:
        return "must not be empty"
    shown = f"'{printable(name, most=60)}'"
    if name[0] == "/":
        return f"{shown} begins with a slash; write '{printable(name.lstrip('/'), most=60)}'"
    if len(name) > MOST_LETTERS:
        return f"{shown} has {len(name)} letters; at most {MOST_LETTERS} are allowed"
    letter = next(letter for letter in name if not letter.isprintable())
    return (
        f"{shown} contains U+{ord(letter):04X}, which cannot be printed: use letters, digits, "
        "spaces and signs"
    )


def is_printable(name: str) -> bool:
    """Whether a name of something else, such as a stream or a node, can be shown and is not too
    long.
    """
    return len(name) <= MOST_LETTERS and name.isprintable()


def did_you_mean(name: str, known: Iterable[str], *, none: str = "") -> str:
    """The end of a sentence about a name that is not known.

    `; did you mean 'sim'?` if one is near, else `; available: a, b and 3 more`; `none` if
    no name is known at all.
    """
    names = sorted(known)
    if not names:
        return none
    near = near_names(name, names, most=1)
    return f"; did you mean {near[0]!r}?" if near else f"; available: {listed(names, most=20)}"


def near_names(name: str, known: Collection[str], *, most: int = 3) -> tuple[str, ...]:
    """The known names that are spelt most like this one, best first; () if none is near.

    Of many names only the ones are compared that begin and end like it.
    """
    from difflib import get_close_matches  # slow to import, and few names are wrong

    if len(known) > _MOST_COUNTED:
        ends = (name[:1], name[-1:])
        alike = sorted(
            other
            for other in known
            if abs(len(other) - len(name)) < 3 and (other[:1], other[-1:]) == ends
        )
        # The neighbours of a name begin like it.
        place = max(sum(other <= name for other in alike) - _MOST_COUNTED // 2, 0)
        known = alike[place : place + _MOST_COUNTED]
    if len(known) > _MOST_COMPARED:
        known = sorted(known, key=lambda other: -_letters_of_ends(name, other))[:_MOST_COMPARED]
    likely = [other for other in known if _may_be_meant(name, other)]
    return tuple(get_close_matches(name, likely, n=most))


def is_slip(name: str, other: str) -> bool:
    """Whether a name may be a slip of another that is in use too: a letter is missing or too many,
    or letters are swapped. Names with other digits, or one other letter, are often of a pair:
    `turtle1` and `turtle2`, `wheel_l` and `wheel_r`.
    """
    shorter, longer = sorted((name, other), key=len)
    if len(shorter) < 3 or len(longer) - len(shorter) > 1 or name == other:
        return False
    if len(shorter) == len(longer):
        is_near = sorted(name) == sorted(other)
    else:
        is_near = _letters_of_ends(shorter, longer) == len(shorter)
    return is_near and re.sub(r"\D", "", name) == re.sub(r"\D", "", other)


def _may_be_meant(one: str, other: str) -> bool:
    """Whether names begin alike, or have the same letters, or most of their ends: `room` is not a
    slip of `odom`, though three letters of four are in it.
    """
    if one[:1] == other[:1] or sorted(one) == sorted(other):
        return True
    return 2 * _letters_of_ends(one, other) > min(len(one), len(other))


def _letters_of_ends(one: str, other: str) -> int:
    """How many letters two names have in common at their beginnings and ends."""
    shorter = min(len(one), len(other))
    begin = next((i for i in range(shorter) if one[i] != other[i]), shorter)
    left = shorter - begin
    return begin + next((i for i in range(left) if one[-1 - i] != other[-1 - i]), left)


def stamp_text(stamp_ns: int) -> str:
    """A stamp in seconds, with nine digits of nanoseconds: `1649109418.661570822`."""
    seconds, nanoseconds = divmod(abs(stamp_ns), 1_000_000_000)
    return f"{'-' if stamp_ns < 0 else ''}{seconds}.{nanoseconds:09}"


def wall(stamp_ns: int) -> str:
    """A time as a clock on the wall shows it here: `2026-11-22 12:03:05.100`."""
    from datetime import datetime  # which few processes need

    seconds, rest_ns = divmod(stamp_ns, 1_000_000_000)
    try:
        local = datetime.fromtimestamp(seconds)
    except (OverflowError, OSError, ValueError):
        return f"{stamp_ns / 1e9:.3f}"
    return f"{local:%Y-%m-%d %H:%M:%S}.{rest_ns // 1_000_000:03}"


def duration(seconds: float | None) -> str:
    """A time as people say it: `0.3 ms`, `4.2 s`, `3 min`, `2 h`, `5 days`; `?` for None."""
    if seconds is None:
        return "?"
    size = abs(seconds)
    if size < 0.01:
        return f"{seconds * 1e3:z.1f} ms"  # no -0.0
    if size < 1.0:
        return f"{seconds * 1e3:.0f} ms"
    if size < 100.0:
        return f"{seconds:.1f} s"
    for most_s, unit_s, unit in ((6e3, 60, "min"), (2e5, 3600, "h")):
        if size < most_s:
            return f"{seconds / unit_s:.0f} {unit}"
    return f"{seconds / 86_400:.0f} days"


def offset(seconds: float) -> str:
    """How far a clock or a stamp is off, with its sign: `+2.5 s`, `-0.3 ms`."""
    said = duration(seconds)
    return said if said.startswith("-") else f"+{said}"


def age(seconds: float | None) -> str:
    """How old something is: `13 ms old`; of a clock that is ahead, `70 ms in the future`."""
    if seconds is not None and seconds < 0.0:
        return f"{duration(-seconds)} in the future"
    return f"{duration(seconds)} old"
