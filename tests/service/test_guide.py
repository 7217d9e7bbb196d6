"""The Guide: every page is served, without a network, and holds together."""

import re
from html.parser import HTMLParser

import pytest

import engine
from engine.diagnose import effect_kinds
from service.guide import ORDER, PAGES, content, markdown, source
from service.guide.reference import catalogue

VOID = {"meta", "link", "img", "input", "br", "polyline"}


class Page(HTMLParser):
    """Tags open and close in order; links and ids."""

    def __init__(self, html):
        super().__init__()
        self.open, self.links, self.ids = [], [], set()
        self.feed(html)
        assert not self.open, self.open

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        if tag == "a":
            self.links.append(attrs["href"])
        if "id" in attrs:
            self.ids.add(attrs["id"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.mark.long
def test_every_page_is_served_and_every_link_of_it_leads_somewhere(client):
    assert {path.stem for path in PAGES.glob("*.md")} == set(ORDER)
    pages = {name: Page(content(name)) for name in ORDER}
    for name, page in pages.items():
        answer = client.get(f"/guide/{name}", headers={"Accept": "text/html"})
        assert answer.status_code == 200
        assert markdown.title(source(name)) in answer.text
        for link in page.links:
            path, _, anchor = link.partition("#")
            if path.startswith("/guide/"):
                target = path.removeprefix("/guide/")
                assert target in ORDER, (name, link)
                assert not anchor or anchor in pages[target].ids, (name, link)
            else:
                assert re.match(r"https?://127.0.0.1|/", link), (name, link)
    assert client.get("/guide", follow_redirects=True).url.path == "/guide/start"
    missing = client.get("/guide/nothing")
    assert (missing.status_code, missing.json()["title"]) == (404, "no such page")


@pytest.mark.long
def test_the_catalogue_holds_every_kind_and_most_have_a_picture():
    kinds = {one.kind for one, _ in catalogue()}
    assert len(kinds) > 0.8 * len(effect_kinds())
    html = content("effects")
    for kind in kinds:
        assert f'<article id="{kind}">' in html
    assert html.count("<polyline") > 10


def test_the_reference_holds_everything_that_is_public():
    html = content("api")
    for name in engine.__all__:
        assert f'<section id="{name}">' in html
    assert "paper, eq. (1)" in html


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("# A <b>", '<h1 id="a-b">A &lt;b&gt;</h1>'),
        ("one\ntwo `x < 1` **yes**", "<p>one two <code>x &lt; 1</code> <strong>yes</strong></p>"),
        ("```sh\na & b\n\n# c\n```", "<pre><code>a &amp; b\n\n# c</code></pre>"),
        ("    a\n\n    b", "<pre><code>a\n\nb</code></pre>"),
        ("- one\n  more\n- two", "<ul><li>one more</li><li>two</li></ul>"),
        ("[x](methods.md#speed)", '<p><a href="/guide/methods#speed">x</a></p>'),
        ("[x](../../../tests/a.md)", "<p>x (<code>tests/a.md</code>)</p>"),
        ("![](a.png) [x](javascript:alert)", "<p> x (<code>javascript:alert</code>)</p>"),
    ],
)
def test_markdown(text, html):
    assert markdown.html(text) == html


def test_a_table():
    made = markdown.html("| a | b |\n| --- | --- |\n| 1 | `2` |")
    Page(made)
    assert '<th scope="col">a</th>' in made
    assert "<td><code>2</code></td>" in made
    assert "---" not in made
