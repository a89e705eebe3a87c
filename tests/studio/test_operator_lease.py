"""One operator at a time moves the rig, is told of, lets go, and is not waited for for ever."""

import asyncio

import pytest

pytest.importorskip("starlette", reason="NiceGUI is not installed")

from tests.refusals import refused

from palpate.core import SafetyError
from palpate.studio.operator_lease import (
    COOKIE,
    MAX_IDLE_S,
    MAX_SILENT_S,
    Operator,
    OperatorCookie,
    RigLease,
    operator_of,
)
from palpate.studio.page_security import cookies_of

ONE, TWO = Operator("a", "10.0.0.1"), Operator("b", "10.0.0.2")


class HandClock:
    """Time that stands until it is moved."""

    def __init__(self):
        self.now_s = 100.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return HandClock()


@pytest.fixture
def lease(clock):
    return RigLease(clock)


def test_who_acts_first_holds_the_rig_and_the_other_is_told_who(lease):
    assert lease.may_act(ONE)
    assert lease.may_act(TWO)
    lease.take(ONE)
    lease.take(ONE)
    assert lease.may_act(ONE)
    assert not lease.may_act(TWO)
    with refused("rig-held", SafetyError, match=r"10\.0\.0\.1"):
        lease.take(TWO)
    assert "10.0.0.1" in lease.words(TWO)
    assert lease.words(ONE) != lease.words(TWO)
    assert ONE.key not in lease.words(TWO).split()


def test_the_rig_is_let_go_of_by_its_holder_alone(lease):
    lease.take(ONE)
    lease.release(TWO)
    assert lease.holder == ONE
    lease.release(ONE)
    lease.take(TWO)
    assert lease.holder == TWO


def test_a_holder_whose_tabs_are_gone_loses_the_rig_and_one_that_is_seen_does_not(lease, clock):
    lease.take(ONE)
    for _ in range(10):
        clock.now_s += 0.9 * MAX_SILENT_S
        lease.see(ONE, recording=False)
        lease.see(TWO, recording=False)
    assert lease.holder == ONE
    clock.now_s += 1.01 * MAX_SILENT_S
    lease.see(TWO, recording=True)
    assert lease.holder is None
    lease.take(TWO)


def test_a_holder_who_does_nothing_loses_the_rig_unless_something_is_recorded(lease, clock):
    lease.take(ONE)
    begun_s = clock.now_s
    while clock.now_s < begun_s + 1.5 * MAX_IDLE_S:
        clock.now_s += 10.0
        lease.see(ONE, recording=True)
    assert lease.holder == ONE
    while clock.now_s < begun_s + 2.6 * MAX_IDLE_S:
        clock.now_s += 10.0
        lease.see(ONE, recording=False)
    assert lease.holder is None


def answered(headers):
    """What the application is told, and what the browser gets."""
    told, sent = {}, []

    async def app(scope, receive, send):
        told.update(cookies_of(scope))
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.extend(message["headers"])

    asyncio.run(OperatorCookie(app)({"type": "http", "headers": headers}, None, send))
    return told, sent


def test_each_browser_has_a_cookie_from_its_first_request_on():
    told, sent = answered([(b"cookie", b"other=1")])
    assert told["other"] == "1"
    ((name, line),) = sent
    assert name == b"set-cookie"
    assert line.decode().startswith(f"{COOKIE}={told[COOKIE]};")
    assert all(word in line for word in (b"HttpOnly", b"SameSite=Strict"))
    again, sent = answered([(b"cookie", line.partition(b";")[0])])
    assert (again, sent) == ({COOKIE: told[COOKIE]}, [])
    assert operator_of(again, "127.0.0.1") == Operator(told[COOKIE], "127.0.0.1")


def test_two_without_a_cookie_are_not_one_operator():
    assert operator_of({}, None).key != operator_of({}, None).key
