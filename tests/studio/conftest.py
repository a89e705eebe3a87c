"""One headless browser for the tests of a module."""

import pytest
from tests.studio import devtools


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if devtools.chromium() is None:
        pytest.skip("there is no Chromium to drive")
    browser = devtools.Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()
