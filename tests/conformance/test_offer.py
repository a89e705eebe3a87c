"""Every conformance check is offered in one place, and asking for one loads no other."""

import subprocess
import sys

import pytest

import palpate.check


@pytest.mark.parametrize("name", ["sensor", "model", "stage", "force_sensor", "camera", "rig"])
def test_the_check_of_each_kind_is_offered(name: str) -> None:
    assert f"check_{name}" in palpate.check.__all__
    check = getattr(palpate.check, f"check_{name}")
    assert check.__name__ == f"check_{name}"
    assert "Example:" in check.__doc__, "a user sees how it is called"


def test_what_is_no_check_is_refused_by_name() -> None:
    with pytest.raises(AttributeError, match=r"'check_glove'.*check_sensor"):
        palpate.check.check_glove  # noqa: B018


def test_the_checks_of_sensors_and_devices_load_no_model() -> None:
    code = "import sys, palpate.check as c; c.check_rig; print(*{'onnx', 'torch'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not done.stdout.strip()
