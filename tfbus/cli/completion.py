"""`tfbus completion`: completion in bash, zsh and fish, by a script of each, and its answers.

click 8 has scripts too, which fall short. bash: no candidates after `:` or `=` (names of frames,
`name:=value` of a launch), and a name with a blank becomes two words. zsh: a space after `name:=`.
fish: messages and help texts end at their first comma.

Our scripts send the line up to the cursor, since bash splits words at `:` and `=`. They get a line
per candidate: its kind (`plain`, `file`, `dir`, or `map`, a message to fill in), the candidate, and
its help, separated by tabs. No space follows a candidate that ends with `=`. Importing this
module makes click use them.
"""

import os
import re
import shlex
from pathlib import Path

import click
from click.shell_completion import (
    CompletionItem,
    ShellComplete,
    add_completion_class,
    split_arg_string,
)


class _Shell(ShellComplete):
    """The part that all three share."""

    def get_completion_args(self) -> tuple[list[str], str]:
        """The words before the cursor's, and that word."""
        line = os.environ.get("TFBUS_LINE", "")
        words = split_arg_string(line)
        is_within_word = _last_word(line) or _open_quote(line)
        incomplete = words.pop() if words and is_within_word else ""
        return words[1:], incomplete

    def format_completion(self, item: CompletionItem) -> str:
        """A line for the script."""
        written = self.quoted if item.type == "map" else self.written
        return "\t".join((item.type, written(item.value), item.help or ""))

    def written(self, value: str) -> str:
        """The candidate, escaped for the shell."""
        return value

    def quoted(self, value: str) -> str:
        """A message in quotes, which reads better than escaped blanks."""
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
        """The part of the candidate that replaces the word as bash sees it."""
        line = os.environ.get("TFBUS_LINE", "")
        if quote := _open_quote(line):
            return _within(quote, value)
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
        """The message as it is: fish escapes it."""
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

# The end of a word in bash, with escaped blanks; and the characters to escape.
_LAST_WORD = re.compile(r"(?:\\.|[^\s\\])*$")
_SPECIAL_IN_QUOTES = re.compile(r'([\\"$`])')
_SPECIAL = re.compile(r"([^\w@%+=:,./-])")


def script(shell: str, command: click.Command) -> str:
    """The script that a shell runs once to complete `tfbus`."""
    return SHELLS[shell](command, {}, "tfbus", "_TFBUS_COMPLETE").source()


def _last_word(line: str) -> str:
    """The word at the end of the line as typed; "" after a blank."""
    found = _LAST_WORD.search(line)
    return found[0] if found else ""


def _within(quote: str, value: str) -> str:
    """The candidate as bash takes it between quotes that are open."""
    if quote == "'":
        return value.replace("'", r"'\''")
    # Between double quotes no escape keeps bash from reading `!` as history: they are closed.
    return _SPECIAL_IN_QUOTES.sub(r"\\\1", value).replace("!", '"\\!"')


def _open_quote(line: str) -> str:
    """The quote within which the line ends; "" outside of quotes."""
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
    return quote


_PLACES = {
    "bash": "~/.local/share/bash-completion/completions/tfbus",
    "zsh": "~/.zfunc/_tfbus",
    "fish": "~/.config/fish/completions/tfbus.fish",
}
_MORE = {
    "bash": "which the package bash-completion reads; or: source FILE in ~/.bashrc",
    "zsh": "with `fpath+=~/.zfunc; autoload -Uz compinit; compinit` in ~/.zshrc",
    "fish": "which fish reads by itself",
}


@click.command(epilog=f"Example: tfbus completion bash > {_PLACES['bash']}")
@click.argument("shell", type=click.Choice(list(SHELLS)), required=False)
def command(shell: str | None) -> None:
    """Print the script that completes tfbus in your shell.

    It completes commands, options, launch files and their arguments, and names on the bus: frames,
    nodes, topics, services and parameters. The default is the shell of $SHELL.
    """
    shell = shell or _own_shell()
    click.echo(script(shell, click.get_current_context().find_root().command), nl=False)
    click.echo(f"# To keep it: tfbus completion {shell} > {_PLACES[shell]}")
    click.echo(f"# {_MORE[shell]}; then open another shell.")


def _own_shell() -> str:
    name = Path(os.environ.get("SHELL", "")).name
    if name not in SHELLS:
        raise click.UsageError(f"$SHELL is none of {', '.join(SHELLS)}: name a shell")
    return name
