"""A headless browser for the tests of a module, and one server for the tests that ask it for pages."""

import pytest
from tests.studio import devtools

REQUEST_S = 1.0
"""Time within which a request to `plain_served` is complete [s]."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if devtools.chromium() is None:
        pytest.skip("there is no Chromium to drive")
    browser = devtools.Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture(scope="session")
def plain_served():
    """The server before a made-up rig at rest, which no test turns into anything else."""
    from tests.studio.test_page_security import Served

    served = Served(REQUEST_S=str(REQUEST_S))
    yield served
    served.close()
