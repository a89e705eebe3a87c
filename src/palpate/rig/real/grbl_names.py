"""GRBL's numbers in words, as far as the driver can meet them."""

from __future__ import annotations

ALARMS = {
    1: "a limit switch was hit; the position is lost",
    2: "a move would have left the machine's own travel",
    3: "reset while moving; the position is lost",
    4: "the probe was triggered already, or is not connected, before the probing move",
    5: "the probe was not triggered within the probing move",
    6: "homing was interrupted by a reset",
    7: "homing was interrupted by the door",
    8: "homing could not leave the switch; is the pull-off ($27) large enough?",
    9: "homing found no switch within its search; check the switches and their wiring",
    10: "emergency stop, or homing of two motors on one axis failed",
    11: "homing is needed first",
    14: "a motor or probe fault",
}

ERRORS = {
    1: "a letter was expected",
    2: "a number could not be read",
    3: "a $ command is not known",
    4: "a number is negative where it may not be",
    5: "homing is switched off; set $22=1 on the machine if it has switches",
    7: "its memory of settings was damaged and is back at the defaults; check every $ setting",
    8: "a $ command came while it was not idle",
    9: "it is locked by an alarm or by a jog",
    10: "soft limits need homing ($22=1)",
    11: "the line was too long",
    15: "the target lies outside the machine's own travel ($130 to $132)",
    16: "a jog held a word that it may not",
    20: "a word is not known",
    22: "no speed was given",
    79: "a limit switch still needs a reset",
}


def alarm_name(code: int) -> str:
    """`ALARM:N` in words.

    Example:
        >>> alarm_name(5)
        'ALARM:5 (the probe was not triggered within the probing move)'
    """
    return f"ALARM:{code} ({ALARMS.get(code, 'see the firmware’s list of alarms')})"


def error_name(code: int) -> str:
    """`error:N` in words."""
    return f"error:{code} ({ERRORS.get(code, 'see the firmware’s list of errors')})"
