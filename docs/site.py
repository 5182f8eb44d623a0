"""Gathers the pages of the site, and builds it from them: `make docs`.

The pages are those of docs/, as they stand there, and the README before them. A link to a file that
is no page, as of examples/ and configs/, leads to a page that shows it.
"""

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from posixpath import normpath, relpath

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
WORK = ROOT / "build" / "site"

# Pages in the root of the repository, which the pages of docs/ link to.
_BESIDE = ("CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md")
_LANGUAGES = {".json5": "json", ".py": "python", ".toml": "toml", ".yaml": "yaml", ".c": "c"}
_LANGUAGES |= {".ipynb": "json", ".js": "js", ".urdf": "xml"}

_LINK = re.compile(r"(\]\()([^)#\s]+)")
_FENCE = re.compile(r"^```.*?^```", re.M | re.S)


class Pages:
    """The pages by their places in the site."""

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.images: dict[str, Path] = {}
        self._shown: set[str] = set()

    def add(self, source: str, place: str) -> None:
        """A page of the repository, at its place in the site, with what it links to."""
        text = (ROOT / source).read_text()
        fences = [match.span() for match in _FENCE.finditer(text)]

        def linked(match: re.Match[str]) -> str:
            if any(begin <= match.start() < end for begin, end in fences):
                return match[0]
            return match[1] + self._link(match[2], source, place)

        self.texts[place] = _LINK.sub(linked, text)

    def _link(self, link: str, source: str, place: str) -> str:
        if "://" in link or link.startswith(("mailto:", "<")):
            return link
        target = normpath(f"{Path(source).parent.as_posix()}/{link}")
        path = ROOT / target
        if not path.exists():
            raise SystemExit(f"{source} links to {link}, which does not exist")
        if path.suffix in (".png", ".svg"):
            there = target.removeprefix("docs/")
            self.images[there] = path
        else:
            there = self._place_of(target)
        return relpath(there, Path(place).parent.as_posix())

    def _place_of(self, target: str) -> str:
        """Where a file or folder of the repository is in the site."""
        if target == "README.md":
            return "index.md"
        if target == "docs/README.md" or target == "docs":
            return "pages.md"
        if target.startswith("docs/") and target.endswith(".md"):
            return target.removeprefix("docs/")
        if target.endswith(".md") or target == "LICENSE":
            return f"about/{target.removesuffix('.md').lower()}.md"
        self._show(target)
        return f"files/{target}.md"

    def _show(self, target: str) -> None:
        """A page that shows a file, or the files of a folder."""
        place = f"files/{target}.md"
        if place in self.texts:
            return
        path = ROOT / target
        if path.is_dir():
            self.texts[place] = f"# {target}\n"
            files = sorted(each.name for each in path.iterdir() if each.suffix in _LANGUAGES)
            rows = [f"- [{name}]({path.name}/{name}.md)" for name in files]
            self.texts[place] = "\n".join([f"# {target}", "", *rows, ""])
            for name in files:
                self._show(f"{target}/{name}")
        else:
            language = _LANGUAGES.get(path.suffix, "text")
            text = path.read_text()
            self.texts[place] = f"# {target}\n\n````{language}\n{text}````\n"


def gathered() -> Pages:
    """All pages of the site."""
    pages = Pages()
    pages.add("README.md", "index.md")
    pages.add("docs/README.md", "pages.md")
    for path in sorted(DOCS.glob("*/*.md")):
        source = path.relative_to(ROOT).as_posix()
        pages.add(source, source.removeprefix("docs/"))
    for name in _BESIDE:
        pages.add(name, f"about/{name.removesuffix('.md').lower()}.md")
    pages.texts["about/license.md"] = f"# Licence\n\n```text\n{(ROOT / 'LICENSE').read_text()}```\n"
    return pages


def sections() -> Iterator[tuple[str, list[tuple[str, str]]]]:
    """The headings of docs/README.md, each with the titles and places of its pages."""
    for section in (DOCS / "README.md").read_text().split("\n## ")[1:]:
        title, _, body = section.partition("\n")
        rows = re.findall(r"^\| \[([^\]]+)\]\(([^)]+\.md)\)", body, re.M)
        if rows:
            yield title, rows


def configuration() -> str:
    """The configuration of zensical: docs/site.toml, and the order of the pages."""
    parts = ['nav = [\n  { "tfbus" = "index.md" },\n  { "All pages" = "pages.md" },']
    for title, rows in sections():
        pages = "\n".join(f'    {{ "{name}" = "{place}" }},' for name, place in rows)
        parts.append(f'  {{ "{title}" = [\n{pages}\n  ] }},')
    names = ("changelog", "contributing", "security", "license")
    about = "\n".join(f'    {{ "{name.capitalize()}" = "about/{name}.md" }},' for name in names)
    parts.append(f'  {{ "About" = [\n{about}\n  ] }},\n]')
    return (
        (DOCS / "site.toml")
        .read_text()
        .replace("# The order of the pages stands here.", "\n".join(parts))
    )


def main() -> None:
    """Gather and build; a broken link fails."""
    shutil.rmtree(WORK, ignore_errors=True)
    pages = gathered()
    for place, text in pages.texts.items():
        file = WORK / "pages" / place
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    for place, path in pages.images.items():
        (WORK / "pages" / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, WORK / "pages" / place)
    (WORK / "zensical.toml").write_text(configuration())
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--clean"]
    ended = subprocess.run([*command, "-f", "zensical.toml"], cwd=WORK)
    if ended.returncode:
        raise SystemExit(ended.returncode)
    print("To read it at http://localhost:8000: python3 -m http.server -d build/site/html")


if __name__ == "__main__":
    main()
