"""Faults of force sensor, stage, camera, disk, operator, computer and skin, on the virtual rig.

Each says how it sets in, what it may be called, whether motion is still possible after it, and how far the
probe may go on into or along the skin once it shows.
"""

from __future__ import annotations

from tests.rig.fault_matrix.fault_injection import (
    AGE,
    OPEN,
    SEARCH,
    STEP,
    TRUST,
    Otherwise,
    RigFault,
    altered,
    backward_stamps,
    both,
    computer_stands_still,
    creeping,
    deaf_and_stalled,
    disk_that,
    drifting_zero,
    failing_watcher,
    harder_skin,
    interrupted,
    jumped,
    killed,
    late_frames,
    late_once,
    no_number,
    of_kind,
    operator,
    raised_skin,
    raising,
    raising_once,
    replacing,
    silent_for,
    slipping,
    slow_disk,
    stage_late,
    stated_stiffness,
    withheld_once,
)

from palpate.core import DeviceError
from palpate.devices import OperatorCommand

GONE = "the stage is gone"
NOT_JUDGED = "at a pause nothing moves, and no sample is judged"
NUMB = "before contact a hum that feels nothing is as a skin that is not there"
FAULTS = (
    RigFault("no sample any more", "force", of_kind("force-stalls"), ("force-stale",), within=AGE),
    RigFault("does not answer", "force", of_kind("force-gone"), ("force-sensor",)),
    RigFault("saturates, or any fault bit", "force", of_kind("force-saturates"), ("force-fault",)),
    RigFault(
        "one sample of 1000 N",
        "force",
        of_kind("force-spike"),
        ("force-limit",),
        elsewhere={
            "idle": Otherwise(("force-noise",), "it falls into the air check of the first approach"),
            "travel": Otherwise(("force-limit", "touched-early"), "in the air any rise by 1 N is a touch"),
            "pause": Otherwise(("done",), NOT_JUDGED),
            "resume": Otherwise(("force-noise", "force-limit"), "it falls into the zero"),
        },
    ),
    RigFault(
        "a hundred times the noise",
        "force",
        of_kind("force-noisy"),
        ("force-noise",),
        elsewhere={
            "idle": Otherwise(
                ("touched-early", "force-noise"), "before the first zero nobody knows the noise", OPEN
            )
        },
    ),
    RigFault(
        "reversed", "force", of_kind("force-reversed"), ("force-reversed",), within=TRUST, shows="force"
    ),
    RigFault(
        "stuck",
        "force",
        of_kind("force-stuck"),
        ("force-stuck",),
        within=TRUST,
        shows="force",
        elsewhere={"idle": Otherwise(("force-dead",), "it never showed noise in this run")},
    ),
    RigFault("dead, all zero", "force", of_kind("force-dead"), ("force-dead",), within=TRUST, shows="force"),
    RigFault(
        "noise that follows nothing",
        "force",
        of_kind("force-numb"),
        ("force-dead",),
        within=TRUST,
        shows="force",
        elsewhere={
            **dict.fromkeys(
                ("idle", "travel", "seek", "pause", "resume"),
                Otherwise(("no-contact", "force-dead"), NUMB, SEARCH),
            ),
            "slide": Otherwise(("force-dead",), "at one depth nothing says what the force should be", SEARCH),
        },
    ),
    RigFault(
        "scaled to a tenth",
        "force",
        of_kind("force-scaled"),
        ("force-scaled",),
        within=TRUST,
        shows="force",
        elsewhere={
            "idle": Otherwise(("done",), "not seen: a known weight tells", OPEN),
            **dict.fromkeys(
                ("pause", "resume"),
                Otherwise(("force-scaled", "force-dead"), "the air check finds equal samples first"),
            ),
        },
    ),
    RigFault(
        "bursts of 80 ms",
        "force",
        of_kind("force-held-back"),
        ("force-late",),
        within=TRUST,
        shows="force",
        elsewhere=dict.fromkeys(
            ("hold", "slide"), Otherwise(("force-late", "force-stale"), "a frame has no force near it")
        ),
    ),
    RigFault(
        "a tenth of its rate", "force", of_kind("force-slow"), ("force-slow",), within=TRUST, shows="force"
    ),
    RigFault(
        "NaN",
        "force",
        both(replacing("force", "drain", no_number), replacing("force", "latest", no_number)),
        ("force-fault",),
    ),
    RigFault(
        "driver raises",
        "force",
        both(
            replacing("force", "drain", raising(KeyError("Fz"))),
            replacing("force", "latest", raising(KeyError("Fz"))),
        ),
        ("force-sensor",),
    ),
    RigFault("call blocks for 1 s", "force", late_once(1.0), ("done",), within=STEP),
    RigFault("does not answer", "stage", of_kind("stage-gone"), ("stage",), stays=GONE, within=STEP),
    RigFault(
        "says that it moves, and stands",
        "stage",
        of_kind("stage-stuck"),
        ("stage", "stage-late"),
        stays="it takes no move",
        within=STEP,
    ),
    RigFault("loses 0.1 mm of every move", "stage", slipping, ("stage",), within=STEP),
    RigFault("count jumps by 0.5 mm", "stage", jumped, ("stage",), within=STEP),
    RigFault(
        "does not stop when told to",
        "stage",
        deaf_and_stalled,
        ("stage", "force-sensor"),
        stays="it does not stop",
        within=STEP,
    ),
    RigFault("a hundredth of its speed", "stage", creeping, ("stage-late", "force-dead"), within=OPEN),
    RigFault("answer 1 s late, once", "stage", stage_late(1.0), ("done",), within=STEP),
    RigFault(
        "no answer, once",
        "stage",
        raising_once("stage", "moving", DeviceError("the stage has not answered")),
        ("stage",),
    ),
    RigFault("driver raises, once", "stage", raising_once("stage", "moving", ValueError("odd")), ("stage",)),
    RigFault(
        "refuses every move",
        "stage",
        replacing("stage", "move_to", raising(DeviceError("the stage refuses to move"))),
        ("stage",),
        stays="it refuses to move",
        within=STEP,
    ),
    RigFault("does not answer", "camera", of_kind("camera-gone"), ("camera",), within=OPEN),
    RigFault(
        "same frame again and again", "camera", of_kind("camera-frozen"), ("camera", "clocks"), within=OPEN
    ),
    RigFault("frames of another size", "camera", of_kind("camera-resized"), ("camera",), within=OPEN),
    RigFault("no frame any more", "camera", of_kind("camera-stalls"), ("camera",), within=OPEN),
    RigFault("every other frame lost", "camera", of_kind("camera-drops"), ("done",), within=OPEN),
    RigFault("frames 1.5 s late", "camera", late_frames(1.5), ("done", "camera"), within=OPEN),
    RigFault("frames 3 s late", "camera", late_frames(3.0), ("camera",), within=OPEN),
    RigFault(
        "stamps run backwards", "camera", backward_stamps, ("camera", "force-stale", "clocks"), within=OPEN
    ),
    RigFault(
        "driver raises",
        "camera",
        both(
            replacing("camera", "grab", raising(RuntimeError("usb"))),
            replacing("camera", "drain", raising(RuntimeError("usb"))),
        ),
        ("camera",),
        within=OPEN,
    ),
    RigFault("full", "disk", disk_that(OSError(28, "No space left on device")), ("storage",), within=OPEN),
    RigFault(
        "input/output error", "disk", disk_that(OSError(5, "Input/output error")), ("storage",), within=OPEN
    ),
    RigFault("slow", "disk", slow_disk, ("done",), within=OPEN),
    RigFault("pause", "operator", operator(OperatorCommand.PAUSE), ("done",)),
    RigFault("stop", "operator", operator(OperatorCommand.STOP), ("stopped", "done"), within=OPEN),
    RigFault("abort, Ctrl-C", "operator", operator(OperatorCommand.ABORT), ("aborted",)),
    RigFault(
        "emergency stop", "operator", operator(OperatorCommand.ESTOP), ("e-stopped",), stays="emergency stop"
    ),
    RigFault("KeyboardInterrupt in any call", "programme", interrupted, ("KeyboardInterrupt",)),
    RigFault("who watches raises", "programme", failing_watcher, ("LookupError",), within=OPEN),
    RigFault(
        "killed (kill -9)",
        "programme",
        killed,
        ("killed",),
        stays="nothing is left that could move it",
        within=STEP,
    ),
    RigFault(
        "stands still for 5 s",
        "programme",
        computer_stands_still,
        ("done",),
        within=STEP,
        elsewhere={"hold": Otherwise(("done", "force-stale"), "a frame has no force near it")},
    ),
    RigFault("nothing to touch", "skin", of_kind("layer-gone"), ("no-contact", "force-dead"), within=SEARCH),
    RigFault(
        "twenty times as stiff",
        "skin",
        harder_skin,
        ("force-implausible", "force-limit", "force-rate"),
        shows="limit",
        elsewhere={
            "idle": Otherwise(("done",), "such a skin is as good as any"),
            "taps": Otherwise(
                ("force-implausible", "force-limit", "force-rate", "clocks"),
                "a tap is then too short for the camera",
            ),
        },
    ),
    RigFault(
        "1.5 mm higher: contact at the clearance",
        "skin",
        raised_skin,
        ("touched-early", "force-implausible", "force-limit", "force-rate"),
        within=TRUST,
        elsewhere={
            "taps": Otherwise(
                ("force-implausible", "touched-early", "clocks"), "a tap is then too short for the camera"
            )
        },
    ),
    RigFault(
        "zero moves by 2 % of the limit in 1 s",
        "force",
        drifting_zero(0.02, 1.0),
        ("force-drift",),
        within=OPEN,
        elsewhere={
            **dict.fromkeys(
                ("idle", "travel"), Otherwise(("force-noise",), "it falls into a zero, and is its noise")
            ),
            "taps": Otherwise(
                ("force-dead",), "a tap's force does not fall as it rose, before its zero is taken"
            ),
        },
    ),
)
"""Faults that end a recording, in the order of the table's rows."""

RECOVERY_FAULTS = (
    RigFault("samples 45 ms late, once", "force", withheld_once(0.045), ("done",), within=OPEN),
    RigFault("no sample for 0.2 s", "force", withheld_once(0.2, lost=True), ("done",), within=OPEN),
    RigFault("does not answer for 0.5 s", "force", silent_for(0.5), ("done",), within=OPEN),
    RigFault(
        "100 ms late, with current timestamps",
        "force",
        altered(delay_s=0.1),
        ("force-lag", "force-dead"),
        within=OPEN,
        elsewhere=dict.fromkeys(
            ("travel", "pause", "resume"),
            Otherwise(
                ("done", "force-dead", "force-lag", "force-noise"),
                "it begins between two presses, and looks as a force that follows too little",
            ),
        ),
    ),
    RigFault(
        "1.8 times the gain, stiffness stated",
        "force",
        both(stated_stiffness, altered(gain=1.8)),
        ("force-scaled",),
        within=TRUST,
        shows="force",
        elsewhere={
            "idle": Otherwise(("stiffness",), "nothing but the skin shows it", OPEN),
            **dict.fromkeys(
                ("taps", "pause", "resume"),
                Otherwise(("force-scaled", "force-dead"), "it begins within a touch, whose force then jumps"),
            ),
        },
    ),
    RigFault(
        "half the gain, stiffness stated",
        "force",
        both(stated_stiffness, altered(gain=0.5)),
        ("force-scaled",),
        within=TRUST,
        shows="force",
        elsewhere={"idle": Otherwise(("stiffness",), "nothing but the skin shows it", OPEN)},
    ),
)
"""Faults that a repeated press overcomes, or that the first touch or press has to show."""

EVERY_FAULT = (*FAULTS, *RECOVERY_FAULTS)
"""All of the virtual rig, as the tables list them."""
