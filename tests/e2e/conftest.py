"""One browser and one service for all tests of the pages, which skip where there is no Chromium."""

import pytest

from tests.e2e.browser import Watched, browser, chromium, service


@pytest.fixture(scope="session")
def chrome():
    pytest.importorskip("playwright", reason="the tests of the pages need playwright")
    if chromium() is None:
        pytest.skip("the tests of the pages need Chromium")
    with browser() as started:
        yield started


@pytest.fixture(scope="session")
def address(tmp_path_factory):
    with service(tmp_path_factory.mktemp("state")) as url:
        yield url


@pytest.fixture
def visit(chrome, address):
    watched = Watched(chrome, address)
    yield watched
    watched.check()
