"""The site: every page is there, and links lead to pages of it."""

import re

import pytest

from docs import site
from tests import needs

PAGES = site.gathered()


def test_every_page_of_the_documentation_is_on_the_site() -> None:
    """Each is in its navigation, too."""
    listed = {place for _, rows in site.sections() for _, place in rows}
    written = {path.relative_to(site.DOCS).as_posix() for path in site.DOCS.glob("*/*.md")}
    assert listed == written
    assert {"index.md", "pages.md", *written} <= PAGES.texts.keys()


def test_the_pages_are_short() -> None:
    """At most 55,000 words in all, and twenty pages of the guide, in five groups."""
    texts = [path.read_text() for path in (site.ROOT / "README.md", *site.DOCS.rglob("*.md"))]
    assert sum(len(re.findall(r"\S*\w\S*", text)) for text in texts) <= 55_000
    groups = [
        [place for _, place in rows if place.startswith("guide/")] for _, rows in site.sections()
    ]
    assert sum(map(len, groups)) <= 20
    assert len(list(filter(None, groups))) == 5


def test_a_link_to_a_program_leads_to_a_page_that_shows_it() -> None:
    """Where the repository has a file, the site has a page with it."""
    assert "](files/examples/listener.py.md)" in PAGES.texts["pages.md"]
    assert "lookup_transform" in PAGES.texts["files/examples/listener.py.md"]
    assert "broadcaster.py" in PAGES.texts["files/examples.md"]


def test_a_page_links_only_to_what_the_site_has() -> None:
    """No link leads out of it."""
    there = {*PAGES.texts, *PAGES.images}
    for place, whole in PAGES.texts.items():
        folder = place.rpartition("/")[0]
        text = re.sub(r"^(`{3,}).*?^\1`*$", "", whole, flags=re.M | re.S)
        for link in re.findall(r"\]\(([^)#\s]+)", text):
            if "://" not in link:
                target = site.normpath(f"{folder}/{link}" if folder else link)
                assert target in there, (place, link)


@pytest.mark.real
def test_the_site_is_built_whole(tmp_path: site.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the command of `make docs`, without a warning; nothing in it comes from elsewhere."""
    needs.module("zensical")
    monkeypatch.setattr(site, "WORK", tmp_path / "site")
    site.main()
    html = tmp_path / "site" / "html"
    built = {path.relative_to(html).as_posix() for path in html.rglob("*.html")}
    assert {place.removesuffix(".md") + ".html" for place in PAGES.texts} <= built
    for page in ("index.html", "reference/api.html"):
        loaded = re.findall(
            r'<(?:script|link|img)[^>]* (?:src|href)="(https?:[^"]*)', (html / page).read_text()
        )
        assert loaded == []
