"""Ready designs, each written as a folder that its owner may edit until the first participant comes.

* ``jelly``: five cups of jelly of other strengths, in ten minutes, with nothing but a spoon and a kettle.
* ``bianchi-2010``: the design of Scilingo, Bianchi, Grioli and Bicchi, IEEE Trans. Haptics 3 (2010) 109,
  doi:10.1109/TOH.2010.2: three conditions, direct and rendered, pairs against the third of five stimuli and
  rankings, three times each, five participants who touch, five who use the display, and five who do both.
* ``threshold``: flats of 21 moduli on a display, placed by what each answer leaves open, and by staircases.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from palpate.core import InputError, RangeError, new_folder
from palpate.psychophysics.experiments.experiment_file import EXPERIMENT, ExperimentDesign, read_design
from palpate.psychophysics.judgements import STIMULI, Stimulus, write_stimuli

MODULI_KPA = (800.0, 500.0, 300.0, 150.0, 100.0)  # of no silicone in particular: the report's are not printed
SOFTENER_PERCENT = (0.0, 10.0, 20.0, 35.0, 45.0)
CLASSES = {"I": "CL1", "K": "CL2", "C": "CL3"}
LAYOUT = {
    "I": "Condition I: stacks of two cylinders of one silicone.",
    "K": "Condition K: a rigid cylinder on each silicone cylinder.",
    "C": "Condition C: stacks of two silicones, one mirrored for another.",
}
JELLY_G = (4.0, 3.3, 2.7, 2.2, 1.8)  # of gelatine in 100 ml
FLATS_KPA = tuple(round(150.0 * 1.06**k, 1) for k in range(-10, 11))
Files = Mapping[str, str]

HEAD = """\
# A design for `palpate experiment run`. Edit it until the first participant comes, and not after: whoever has
# begun goes on by the same design alone.
name = "{name}"
seed = {seed}                # of everything that is drawn
conditions = {conditions}
handedness = {handedness}     # ask for the ten activities of the Edinburgh inventory
age = "{age}"                # or "years", or "band"; nobody has to answer
"""


def make_experiment(
    folder: Path, preset: str, seed: int, moduli_kpa: Sequence[float] | None = None
) -> ExperimentDesign:
    """Write the folder of a preset; `moduli_kpa` of ``bianchi-2010`` are for 0 to 45 % softener."""
    if preset not in PRESETS:
        raise InputError(f"preset {preset!r}; there are {', '.join(PRESETS)}", code="preset-unknown")
    if not 0 <= seed < 1 << 63:
        raise RangeError(f"seed {seed}; 0 to {(1 << 63) - 1} are allowed")
    if moduli_kpa is not None and preset != "bianchi-2010":
        raise InputError(f"moduli are for the preset bianchi-2010; {preset} has none: leave them out")
    moduli = tuple(moduli_kpa or MODULI_KPA)
    if len(moduli) != len(MODULI_KPA) or not all(0 < one < float("inf") for one in moduli):
        raise InputError(
            f"moduli {moduli} kPa; five above 0 are needed, from 0 to 45 % of softener", code="moduli-count"
        )
    if any(softer >= harder for harder, softer in pairwise(moduli)):
        said = " ".join(f"{one:g}" for one in moduli)
        raise InputError(
            f"moduli {said} kPa; from 0 to 45 % of softener they have to fall", code="moduli-order"
        )
    stimuli, files = PRESETS[preset](seed, moduli, moduli_kpa is not None)
    with new_folder(folder) as part:
        write_stimuli(part / STIMULI, stimuli)
        for name, text in files.items():
            (part / name).parent.mkdir(exist_ok=True)
            (part / name).write_text(text, encoding="utf-8")
        read_design(part)
    return read_design(folder)


def _head(name: str, seed: int, conditions: str, age: str, *, handedness: bool) -> str:
    asked = "true" if handedness else "false"
    return HEAD.format(name=name, seed=seed, conditions=conditions, handedness=asked, age=age)


def _group(name: str, participants: int, *presentations: str) -> str:
    named = ", ".join(f'"{one}"' for one in presentations)
    return f'\n[[group]]\nname = "{name}"\nparticipants = {participants}\npresentations = [{named}]\n'


def _set(
    presentation: str,
    condition: str,
    names: Sequence[str],
    standard: str,
    objects: Sequence[str],
    layout: str,
) -> str:
    def listed(words: Sequence[str]) -> str:
        return "[" + ", ".join(f'"{word}"' for word in words) + "]"

    lines = [
        "\n[[stimuli]]", f'presentation = "{presentation}"', f'condition = "{condition}"',
        f"names = {listed(names)}", f'standard = "{standard}"',
        *([f"objects = {listed(objects)}"] if objects else []), *([f'layout = "{layout}"'] if layout else []),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _tasks(*tasks: str) -> str:
    return "".join(f"\n[[task]]\n{task}\n" for task in tasks)


def _jelly(seed: int, moduli: Sequence[float], given: bool) -> tuple[list[Stimulus], Files]:
    names = [f"cup{k + 1}" for k in range(len(JELLY_G))]
    stimuli = [Stimulus(one, grams, -1, "g/100ml") for one, grams in zip(names, JELLY_G, strict=True)]
    text = _head("five cups of jelly", seed, '["I"]', "no", handedness=False)
    text += _group("direct", 5, "direct") + _set("direct", "I", names, "cup3", (), "")
    return stimuli, {EXPERIMENT: text + _tasks(_constant(3), _rank(1))}


def _bianchi(seed: int, moduli: Sequence[float], given: bool) -> tuple[list[Stimulus], Files]:
    stimuli = [
        Stimulus(f"{kind}{k + 1}", percent, 1, "percent softener")
        for kind in ("SS", "SH")
        for k, percent in enumerate(SOFTENER_PERCENT)
    ]
    text = _head("softness, direct and rendered", seed, '["I", "K", "C"]', "years", handedness=True)
    text += _group("direct", 5, "direct") + _group("rendered", 5, "rendered")
    text += _group("both", 5, "direct", "rendered")
    files: dict[str, str] = {}
    for condition, kind in CLASSES.items():
        touched = [f"SS{k + 1}" for k in range(5)]
        text += _set("direct", condition, touched, "SS3", (), LAYOUT[condition])
        rendered = [f"SH{k + 1}" for k in range(5)]
        objects = [f"objects/{one}-{condition}.toml" for one in rendered]
        text += _set("rendered", condition, rendered, "SH3", objects, "")
        files |= {one: _specimen(kind, k + 1, moduli, given) for k, one in enumerate(objects)}
    return stimuli, {EXPERIMENT: text + _tasks(_constant(3), _rank(3)), **files}


def _threshold(seed: int, moduli: Sequence[float], given: bool) -> tuple[list[Stimulus], Files]:
    names = [f"F{k + 1:02d}" for k in range(len(FLATS_KPA))]
    stimuli = [Stimulus(one, kpa, -1, "kPa") for one, kpa in zip(names, FLATS_KPA, strict=True)]
    objects = [f"objects/{one}.toml" for one in names]
    text = _head("thresholds of rendered softness", seed, '["I"]', "no", handedness=False)
    text += _group("rendered", 8, "rendered") + _set("rendered", "I", names, names[10], objects, "")
    staircase = (
        'method = "staircase"\nsides = ["softer", "harder"]\nright = 2                   # 2 right, 1 wrong: '
        "settles at 70.7 % right\nsteps = [3, 2, 1]\nreversals = 8"
    )
    files = {path: _flat(kpa) for path, kpa in zip(objects, FLATS_KPA, strict=True)}
    return stimuli, {EXPERIMENT: text + _tasks('method = "bayesian"\ntrials = 40', staircase), **files}


def _constant(repeats: int) -> str:
    return f'method = "constant"         # every other stimulus against the standard\nrepeats = {repeats}'


def _rank(repeats: int) -> str:
    return f'method = "rank"\nrepeats = {repeats}'


def _specimen(kind: str, number: int, moduli: Sequence[float], given: bool) -> str:
    said = "as given" if given else "of no silicone in particular: put in what you measured"
    return f"""\
[specimen]
class = "{kind}"
number = {number}
moduli_kPa = [{", ".join(f"{one:g}" for one in moduli)}]   # {said}
poisson = 0.499
finger_modulus_kPa = 75
finger_radius_mm = 15
finger_poisson = 0.5
until_N = 1.5
"""


def _flat(kpa: float) -> str:
    return f"""\
[fingertip]
model = "hertz"
modulus_kPa = 75
radius_mm = 15
poisson = 0.5
until_N = 1.5

[material]
name = "a flat"
modulus_kPa = {kpa:g}
poisson = 0.49
"""


PRESETS: Mapping[str, Callable[[int, Sequence[float], bool], tuple[list[Stimulus], Files]]] = {
    "jelly": _jelly,
    "bianchi-2010": _bianchi,
    "threshold": _threshold,
}
"""Designs by name: seed, moduli and whether they were given, to stimuli and files."""
