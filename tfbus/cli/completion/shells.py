"""Completion in bash, zsh and fish: the script of each, and how it is answered.

The scripts hand over the line as it is typed up to the cursor, since bash splits words at `:` and
`=`, which names may have. They get a line for each candidate: what it is (`plain`, `file`, `dir`,
or `map`, a message to fill in), itself, and what there is to say of it, with tabs between. One
that ends in `=` is not whole: no space comes after it. Importing this module makes click use them
in place of its own.
"""

import os
import re
import shlex

import click
from click.shell_completion import (
    CompletionItem,
    ShellComplete,
    add_completion_class,
    split_arg_string,
)


class _Shell(ShellComplete):
    """What the three have in common."""

    def get_completion_args(self) -> tuple[list[str], str]:
        """The words before the one at the cursor, and that one."""
        line = os.environ.get("TFBUS_LINE", "")
        words = split_arg_string(line)
        is_within_word = _last_word(line) or _is_in_quotes(line)
        incomplete = words.pop() if words and is_within_word else ""
        return words[1:], incomplete

    def format_completion(self, item: CompletionItem) -> str:
        """One line for the script."""
        written = self.quoted if item.type == "map" else self.written
        return "\t".join((item.type, written(item.value), item.help or ""))

    def written(self, value: str) -> str:
        """The candidate as the shell wants it."""
        return value

    def quoted(self, value: str) -> str:
        """A message as the shell wants it, in quotes rather than with every blank escaped."""
        return shlex.quote(value)


class Bash(_Shell):
    """bash 4.4 and newer."""

    name = "bash"
    source_template = """\
_tfbus_completion() {
    local kind value
    COMPREPLY=()
    while IFS=$'\\t' read -r kind value _; do
        case $kind in
            plain | map)
                COMPREPLY+=("$value")
                [[ $value == *= ]] && compopt -o nospace
                ;;
            dir) compopt -o dirnames ;;
            file) compopt -o default ;;
        esac
    done < <(TFBUS_LINE=${COMP_LINE:0:COMP_POINT} TFBUS_BREAKS=$COMP_WORDBREAKS \\
        %(complete_var)s=bash_complete "$1" 2>/dev/null)
}
complete -o nosort -F _tfbus_completion %(prog_name)s
"""

    def written(self, value: str) -> str:
        """The part of the candidate that takes the place of the part that bash sees of the word."""
        line = os.environ.get("TFBUS_LINE", "")
        if _is_in_quotes(line):
            return value
        typed = _last_word(line)
        breaks = set(os.environ.get("TFBUS_BREAKS", "")) - set(" \t\n\"'")
        seen_from = max((at + 1 for at, char in enumerate(typed) if char in breaks), default=0)
        return _SPECIAL.sub(r"\\\1", value)[seen_from:]


class Zsh(_Shell):
    """zsh 5."""

    name = "zsh"
    source_template = """\
#compdef %(prog_name)s

_tfbus_completion() {
    local kind value text
    local -a plain shown open
    while IFS=$'\\t' read -r kind value text; do
        case $kind in
            plain)
                if [[ $value == *= ]]; then
                    open+=("$value")
                else
                    plain+=("$value")
                    shown+=("$value${text:+  -- $text}")
                fi
                ;;
            map) compadd -Q -U -V tfbus -- "$value" ;;
            dir) _path_files -/ ;;
            file) _path_files ;;
        esac
    done < <(TFBUS_LINE="${(j: :)words[1,CURRENT-1]} $PREFIX" \\
        %(complete_var)s=zsh_complete %(prog_name)s 2>/dev/null)
    (( $#plain )) && compadd -U -l -V tfbus -d shown -a plain
    (( $#open )) && compadd -U -S '' -V tfbus -a open
}

if [[ $zsh_eval_context[-1] == loadautofunc ]]; then
    _tfbus_completion "$@"
else
    compdef _tfbus_completion %(prog_name)s
fi
"""


class Fish(_Shell):
    """fish 3."""

    name = "fish"

    def quoted(self, value: str) -> str:
        """The message itself: fish escapes what it inserts."""
        return value

    source_template = """\
function _tfbus_completion
    set -lx TFBUS_LINE (commandline -cp | string collect)
    set -lx %(complete_var)s fish_complete
    for row in (%(prog_name)s 2>/dev/null)
        set -l parts (string split \\t -- $row)
        switch $parts[1]
            case plain map
                echo $parts[2]\\t$parts[3]
            case dir
                __fish_complete_directories (commandline -ct)
            case file
                __fish_complete_path (commandline -ct)
        end
    end
end
complete --no-files --command %(prog_name)s --arguments "(_tfbus_completion)"
"""


SHELLS: dict[str, type[_Shell]] = {"bash": Bash, "zsh": Zsh, "fish": Fish}

for _each in SHELLS.values():
    add_completion_class(_each)

# What a word of bash ends with, blanks that are escaped in it; and what has to be escaped.
_LAST_WORD = re.compile(r"(?:\\.|[^\s\\])*$")
_SPECIAL = re.compile(r"([^\w@%+=:,./~-])")


def script(shell: str, command: click.Command) -> str:
    """The script that a shell runs once to know how to complete `tfbus`."""
    return SHELLS[shell](command, {}, "tfbus", "_TFBUS_COMPLETE").source()


def _last_word(line: str) -> str:
    """What is typed of the word at the end, "" after a blank."""
    found = _LAST_WORD.search(line)
    return found[0] if found else ""


def _is_in_quotes(line: str) -> bool:
    """Whether the line ends within quotes that are open."""
    quote = ""
    escaped = False
    for char in line:
        if escaped:
            escaped = False
        elif char == "\\" and quote != "'":
            escaped = True
        elif quote:
            quote = "" if char == quote else quote
        elif char in "\"'":
            quote = char
    return bool(quote)
