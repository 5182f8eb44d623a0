"""What `${...}` stands for in a launch file, and when an `if:` is true.

`${name}` is the launch argument of that name, `${env:NAME}` an environment variable (an error if
it is not set), `${env:NAME:text}` the same with a text for when it is not set, `${here}` the
folder of the launch file. `$${` stands for a plain `${`; any other `$` is a plain `$`.
Substitution happens once: what comes in is not looked at again.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from tfbus.launch.place import Place, nearest

HERE = "here"

_SUBSTITUTION = re.compile(r"\$\$\{|\$\{(?P<inside>[^{}]*)\}|\$\{")
_COMPARISON = re.compile(r"(?P<left>.*?)(?P<sign>==|!=)(?P<right>.*)", re.DOTALL)
_TRUTH = {word: True for word in ("true", "yes", "on", "1")} | {
    word: False for word in ("false", "no", "off", "0")
}


@dataclass(frozen=True, slots=True)
class Scope:
    """What is known while one launch file is read."""

    arguments: Mapping[str, str]
    environment: Mapping[str, str]
    here: str

    def expand(self, text: str, place: Place) -> str:
        """The text with every substitution made.

        Raises LaunchFileError for an argument or a variable that does not exist.
        """

        def replaced(match: re.Match[str]) -> str:
            if match.group() == "$${":
                return "${"
            inside = match.group("inside")
            if inside is None:
                raise place.mistake("'${' without its '}'; write '$${' for a plain '${'")
            return self._value(inside.strip(), place)

        return _SUBSTITUTION.sub(replaced, text)

    def is_true(self, text: str, place: Place) -> bool:
        """Whether a condition holds: a word for true or false, or `a == b`, `a != b` (as text).

        Raises LaunchFileError for any other text.
        """
        if comparison := _COMPARISON.fullmatch(text):
            left, right = (
                self.expand(comparison[side], place).strip() for side in ("left", "right")
            )
            return (left == right) is (comparison["sign"] == "==")
        return truth(self.expand(text, place), place)

    def _value(self, inside: str, place: Place) -> str:
        if inside == HERE:
            return self.here
        if inside.startswith("env:"):
            return self._variable(inside.removeprefix("env:"), place)
        if inside in self.arguments:
            return self.arguments[inside]
        if inside in self.environment:
            raise place.mistake(
                f"no argument is called {inside!r}; an environment variable is ${{env:{inside}}}, "
                f"and $${{{inside}}} is left for a shell"
            )
        raise place.mistake(
            f"no argument is called {inside!r}{nearest(inside, self.arguments)} "
            "Declare it under 'arguments:'"
        )

    def _variable(self, name: str, place: Place) -> str:
        name, has_default, default = name.partition(":")
        if name in self.environment:
            return self.environment[name]
        if has_default:
            return default
        raise place.mistake(
            f"the environment variable {name!r} is not set; set it, or write "
            f"${{env:{name}:text}} to say what stands for it then"
        )


def truth(text: str, place: Place) -> bool:
    """True or False for the words that YAML has for them (and 1 and 0)."""
    try:
        return _TRUTH[text.strip().lower()]
    except KeyError:
        raise place.mistake(f"must be true or false, and is {text!r}") from None
