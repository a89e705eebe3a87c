"""Faults of force sensor, stage, camera, disk, operator, computer and skin, on the virtual rig.

Each says how it sets in, what it may be called, whether motion is still possible after it, and how far the
probe may go on into or along the skin once it shows.
"""

from functools import partial

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
    sampling,
    silent_for,
    slipping,
    slow_disk,
    stated_stiffness,
    withheld_once,
)

from palpate.core import DeviceError
from palpate.devices import OperatorCommand

GONE = "the stage is gone"
NOT_JUDGED = "at a pause nothing moves, and no sample is judged"
NUMB = "before contact a hum that feels nothing is as a skin that is not there"
force_fault = partial(RigFault, "force")
stage_fault = partial(RigFault, "stage")
camera_fault = partial(RigFault, "camera")
disk_fault = partial(RigFault, "disk")
operator_fault = partial(RigFault, "operator")
programme_fault = partial(RigFault, "programme")
skin_fault = partial(RigFault, "skin")
FAULTS = (
    force_fault("no sample any more", of_kind("force-stalls"), ("force-stale",), within=AGE),
    force_fault("does not answer", of_kind("force-gone"), ("force-sensor",)),
    force_fault("saturates, or any fault bit", of_kind("force-saturates"), ("force-fault",)),
    force_fault(
        "one sample of 1000 N",
        of_kind("force-spike"),
        ("force-limit",),
        elsewhere={
            "idle": Otherwise(("force-noise",), "it falls into the air check of the first approach"),
            "travel": Otherwise(("force-limit", "touched-early"), "in the air any rise by 1 N is a touch"),
            "pause": Otherwise(("done",), NOT_JUDGED),
            "resume": Otherwise(("force-noise", "force-limit"), "it falls into the zero"),
        },
    ),
    force_fault(
        "a hundred times the noise",
        of_kind("force-noisy"),
        ("force-noise",),
        elsewhere={
            "idle": Otherwise(
                ("touched-early", "force-noise"), "before the first zero nobody knows the noise", OPEN
            )
        },
    ),
    force_fault("reversed", of_kind("force-reversed"), ("force-reversed",), within=TRUST, shows="force"),
    force_fault(
        "stuck", of_kind("force-stuck"), ("force-stuck",), within=TRUST, shows="force",
        elsewhere={"idle": Otherwise(("force-dead",), "it never showed noise in this run")},
    ),
    force_fault("dead, all zero", of_kind("force-dead"), ("force-dead",), within=TRUST, shows="force"),
    force_fault(
        "noise that follows nothing",
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
    force_fault(
        "scaled to a tenth",
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
    force_fault(
        "bursts of 80 ms",
        of_kind("force-held-back"),
        ("force-late",),
        within=TRUST,
        shows="force",
        elsewhere=dict.fromkeys(
            ("hold", "slide"), Otherwise(("force-late", "force-stale"), "a frame has no force near it")
        ),
    ),
    force_fault("a tenth of its rate", of_kind("force-slow"), ("force-slow",), within=TRUST, shows="force"),
    force_fault("NaN", sampling(no_number), ("force-fault",)),
    force_fault("driver raises", sampling(raising(KeyError("Fz"))), ("force-sensor",)),
    force_fault("call blocks for 1 s", late_once("force", "drain", 1.0), ("done",), within=STEP),
    stage_fault("does not answer", of_kind("stage-gone"), ("stage",), stays=GONE, within=STEP),
    stage_fault(
        "says that it moves, and stands",
        of_kind("stage-stuck"),
        ("stage", "stage-late"),
        stays="it takes no move",
        within=STEP,
    ),
    stage_fault("loses 0.1 mm of every move", slipping, ("stage",), within=STEP),
    stage_fault("count jumps by 0.5 mm", jumped, ("stage",), within=STEP),
    stage_fault(
        "does not stop when told to",
        deaf_and_stalled,
        ("stage", "force-sensor"),
        stays="it does not stop",
        within=STEP,
    ),
    stage_fault("a hundredth of its speed", creeping, ("stage-late", "force-dead"), within=OPEN),
    stage_fault("answer 1 s late, once", late_once("stage", "moving", 1.0), ("done",), within=STEP),
    stage_fault(
        "no answer, once",
        raising_once("stage", "moving", DeviceError("the stage has not answered")),
        ("stage",),
    ),
    stage_fault("driver raises, once", raising_once("stage", "moving", ValueError("odd")), ("stage",)),
    stage_fault(
        "refuses every move",
        replacing("stage", "move_to", raising(DeviceError("the stage refuses to move"))),
        ("stage",),
        stays="it refuses to move",
        within=STEP,
    ),
    camera_fault("does not answer", of_kind("camera-gone"), ("camera",), within=OPEN),
    camera_fault("same frame again and again", of_kind("camera-frozen"), ("camera", "clocks"), within=OPEN),
    camera_fault("frames of another size", of_kind("camera-resized"), ("camera",), within=OPEN),
    camera_fault("no frame any more", of_kind("camera-stalls"), ("camera",), within=OPEN),
    camera_fault("every other frame lost", of_kind("camera-drops"), ("done",), within=OPEN),
    camera_fault("frames 1.5 s late", late_frames(1.5), ("done", "camera"), within=OPEN),
    camera_fault("frames 3 s late", late_frames(3.0), ("camera",), within=OPEN),
    camera_fault("stamps run backwards", backward_stamps, ("camera", "force-stale", "clocks"), within=OPEN),
    camera_fault(
        "driver raises",
        both(
            replacing("camera", "grab", raising(RuntimeError("usb"))),
            replacing("camera", "drain", raising(RuntimeError("usb"))),
        ),
        ("camera",),
        within=OPEN,
    ),
    disk_fault("full", disk_that(OSError(28, "No space left on device")), ("storage",), within=OPEN),
    disk_fault("input/output error", disk_that(OSError(5, "Input/output error")), ("storage",), within=OPEN),
    disk_fault("slow", slow_disk, ("done",), within=OPEN),
    operator_fault("pause", operator(OperatorCommand.PAUSE), ("done",)),
    operator_fault("stop", operator(OperatorCommand.STOP), ("stopped", "done"), within=OPEN),
    operator_fault("abort, Ctrl-C", operator(OperatorCommand.ABORT), ("aborted",)),
    operator_fault("emergency stop", operator(OperatorCommand.ESTOP), ("e-stopped",), stays="emergency stop"),
    programme_fault("KeyboardInterrupt in any call", interrupted, ("KeyboardInterrupt",)),
    programme_fault("who watches raises", failing_watcher, ("LookupError",), within=OPEN),
    programme_fault(
        "killed (kill -9)", killed, ("killed",), stays="nothing is left that could move it", within=STEP
    ),
    programme_fault(
        "stands still for 5 s",
        computer_stands_still,
        ("done",),
        within=STEP,
        elsewhere={"hold": Otherwise(("done", "force-stale"), "a frame has no force near it")},
    ),
    skin_fault("nothing to touch", of_kind("layer-gone"), ("no-contact", "force-dead"), within=SEARCH),
    skin_fault(
        "twenty times as stiff",
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
    skin_fault(
        "1.5 mm higher: contact at the clearance",
        raised_skin,
        ("touched-early", "force-implausible", "force-limit", "force-rate"),
        within=TRUST,
        elsewhere={
            "taps": Otherwise(
                ("force-implausible", "touched-early", "clocks"), "a tap is then too short for the camera"
            )
        },
    ),
    force_fault(
        "zero moves by 2 % of the limit in 1 s",
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
)  # fmt: skip
"""Faults that end a recording, in the order of the table's rows."""

RECOVERY_FAULTS = (
    force_fault("samples 45 ms late, once", withheld_once(0.045), ("done",), within=OPEN),
    force_fault("no sample for 0.2 s", withheld_once(0.2, lost=True), ("done",), within=OPEN),
    force_fault("does not answer for 0.5 s", silent_for(0.5), ("done",), within=OPEN),
    force_fault(
        "100 ms late, with current timestamps",
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
    force_fault(
        "1.8 times the gain, stiffness stated",
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
    force_fault(
        "half the gain, stiffness stated",
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
