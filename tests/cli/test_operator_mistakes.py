"""What a tired operator does to files: named with the file, the fault and what to do."""

import datetime
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits

import truenewton as tn
from helpers.balanced import p45_bench, p45_matrix
from helpers.changed import p45, said, with_forces
from truenewton.bench.simulated.static import run_cycles, static_bench
from truenewton.errors import RankDeficient, TooManyOutliers
from truenewton.estimation.screening.screen import screen_campaign
from truenewton.mirrors.known import p45 as p45_mirror
from truenewton.records.campaign import Campaign

ONE = 6  # of four files a load, the third under the ring


def quiet(count=4):
    return p45(1e-4, count)


def times(factor, *files):
    """Return cycles of which FORCE is so many times as large, in all files or some."""
    return lambda: with_forces(quiet(), lambda k, f: f * factor if k in files or not files else f)


def changed(change, *files):
    """Return cycles of which some, or all, are changed."""
    return lambda: [
        change(cycle) if k in files or not files else cycle for k, cycle in enumerate(quiet())
    ]


def columns(order, *names, files=(ONE,)):
    """Return cycles in some of which columns of FORCE or POSITION stand in another order."""
    return changed(lambda c: replace(c, **{n: np.array(getattr(c, n))[:, order] for n in names}),
                   *files)  # fmt: skip


def holding(*at):
    """Return what lets sensors read in each row what they read in the first."""

    def change(cycle):
        position = np.array(cycle.position)
        position[:, at] = position[0, at]
        return replace(cycle, position=position)

    return change


def exchanged(one, other):
    order = np.arange(45)
    order[[one, other]] = other, one
    return order


def load(cycle, **parts):
    return replace(cycle, load=replace(cycle.load, **parts))


def of_another_mirror(*places):
    """Return cycles some of which are of a mirror of the same name, whose actuators are others."""
    other = list(run_cycles(replace(static_bench(p45_mirror(), 8), force_noise=1e-4), 4))
    return [other[k] if k in places else cycle for k, cycle in enumerate(quiet())]


def one_file_everywhere():
    first = quiet()[0]
    return [replace(c, force=first.force, position=first.position) for c in quiet()[2:6]]


def dated(cycle):
    return replace(cycle, date=cycle.date.replace(year=2062))


def weights(factor):
    return changed(lambda c: replace(load(c, added=factor * c.load.added),
                                     weight=factor * c.weight))  # fmt: skip


def added(cycle, weight):
    return load(cycle, added=weight, added_error=0.005)


NOT = ("rejected",)
REFUSED = (None,)
IN_ORDER = "in the order of ACTUATORS, or leave it out"
FORCE_IN, WEIGHTS_IN = "correct the unit of FORCE where", "store WEIGHT and ADDED in N"
FAULTS = {
    # units and signs, of all files
    "kN": (times(1e-3), NOT, "FORCE looks as if in kN, or WEIGHT and ADDED look as if in mN",
           "ADDED is about 910 times too large", FORCE_IN),
    "counts": (times(1e5), NOT, "as if in counts or volts of the electronics", FORCE_IN),
    "all in grams": (weights(101.97), NOT, "WEIGHT and ADDED look as if in g", WEIGHTS_IN),
    "the mirror in ADDED": (
        changed(lambda c: added(c, c.weight + c.load.added), 4, 5, 6, 7),
        NOT, "ADDED looks as if the weight of the mirror were in it", "store what was added alone",
    ),
    # columns, of one file
    **{
        f"{what} of {a + 1} and {b + 1} exchanged": (
            columns(exchanged(a, b), *what.lower().split(" and ")), NOT + REFUSED,
            f"exchanged columns of {what}", f"actuators {a + 1} and {b + 1} in ring 3", IN_ORDER,
        )
        for a, b, what in ((10, 11, "POSITION"), (20, 44, "FORCE and POSITION"))
    },
    "under the ring": (
        columns(exchanged(10, 11), "force", files=range(4, 8)),
        NOT, "actuators 11 and 12 in ring 1, ring 2 and 2 more, or in bare 1", IN_ORDER,
    ),
    "all columns shifted": (
        columns(np.roll(np.arange(45), 1), "force"),
        REFUSED, "another order of FORCE: 45 of 45 actuators in ring 3", IN_ORDER,
    ),
    # files that do not belong together
    "one of another mirror": (
        lambda: of_another_mirror(ONE), REFUSED,
        "not one of its rows fits the other files", "leave it out",
    ),
    "bare of one, ring of another mirror": (
        lambda: of_another_mirror(4, 5, 6, 7),
        NOT, "unknown effect", "shapes or mirrors that differ between files",
    ),
    "one file everywhere": (
        one_file_everywhere, REFUSED + NOT, "copy of another file", "restore the original",
    ),
    "a date of next century": (
        changed(dated, ONE), ("usable", "doubtful"),
        "DATE-OBS of ring 3 is 13149 days from that of the other", "correct DATE-OBS",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("made", "level", "words"),
                         [(made, level, words) for made, level, *words in FAULTS.values()],
                         ids=FAULTS)  # fmt: skip
def test_the_first_finding_names_the_mistake_its_place_and_the_remedy(made, level, words):
    found, *sentences = said(made())
    assert found in level
    text = "; ".join(sentences)
    assert all(word in text for word in words), text


SOUND = {
    "other cases and blanks": changed(lambda c: load(c, name=" Ring "), ONE),
    "a ring put on elsewhere, by its name": lambda: [
        c if k < 6 else load(replace(c, force=c.force + 2e-3 * p45_bench().truth.layout.x / 0.1),
                             name="ring, turned")
        for k, c in enumerate(quiet())
    ],
    "shapes 3 % larger under the ring": lambda: [
        c if k < 4 else larger(c) for k, c in enumerate(quiet())
    ],
    "other shapes in one file": changed(lambda c: replace(c, shape=c.shape + 1000), ONE),
    "files of different days": lambda: [
        replace(c, date=c.date + datetime.timedelta(days=2 * k)) for k, c in enumerate(quiet(2))
    ],
    "no POSITION": changed(lambda c: replace(c, position=None)),
    "few shapes in common": changed(lambda c: replace(c, valid=c.shape != 1 + c.number)),
}  # fmt: skip


def larger(cycle):
    rest = [np.asarray(values).mean(axis=0) for values in (cycle.force, cycle.position)]
    force, position = (
        mean + 1.03 * (values - mean)
        for values, mean in zip((cycle.force, cycle.position), rest, strict=True)
    )
    return replace(cycle, force=force, position=position)


@pytest.mark.parametrize("made", SOUND.values(), ids=SOUND)
def test_sound_data_give_no_finding_of_a_mistake(made):
    verdict = tn.calibrate(Campaign(tuple(made()))).verdict
    text = " ".join(each.fault for each in verdict.faults)
    for word in ("exchanged", "order", "sign", "unit", "two names", "load is", "DATE-OBS",
                 "TEMPERATURE", "POSITION"):  # fmt: skip
        assert word not in text


@pytest.mark.filterwarnings("ignore::truenewton.errors.TrueNewtonWarning")
def test_frozen_sensors_are_named_where_a_stiffness_is_made_of_their_rows():
    alone, five = (Campaign(tuple(changed(holding(*at))())) for at in ((7,), (3, 7, 9, 20, 30)))
    good = tn.calibrate(Campaign(tuple(quiet())))
    for what in (
        lambda: tn.measured_stiffness(five),
        lambda: tn.calibrate(alone, "reciprocity"),
        lambda: tn.find_modes(alone, good),
    ):
        with pytest.raises(RankDeficient, match=r"frozen sensor: POSITION of actuator"):
            what()
    once = tn.find_modes(Campaign(tuple(changed(holding(7), ONE)())), good)
    assert len(once.measured.rejected) > 80  # nearly all rows of that file stand off the others


# --- a file in the place of another -------------------------------------------------------------


@pytest.fixture(scope="module")
def paths(p45_folder, tmp_path_factory):
    """One path of each kind, by its name."""
    folder = tmp_path_factory.mktemp("kinds")
    kinds = {name: folder / file for name, file in (
        ("empty folder", "empty"), ("folder of text", "notes"), ("folder of folders", "folders"),
        ("nothing", "nothing.fits"),
        ("empty file", "zero.fits"), ("text", "text.fits"), ("image", "image.fits"),
        ("table", "table.fits"), ("calibration", "alpha.fits"), ("plan", "plan.toml"),
        ("no TOML", "bad.toml"), ("stiffness", "stiffness.fits"),
    )}  # fmt: skip
    kinds["empty folder"].mkdir()
    kinds["folder of text"].mkdir()
    (kinds["folder of text"] / "notes.txt").write_text("x")
    (kinds["folder of folders"] / "sub.fits").mkdir(parents=True)
    kinds["empty file"].touch()
    kinds["text"].write_text("no FITS\n")
    fits.PrimaryHDU(np.zeros((10, 10))).writeto(kinds["image"])
    column = fits.Column("A", "D", array=np.ones(3))
    table = fits.BinTableHDU.from_columns([column], name="OTHER")
    fits.HDUList([fits.PrimaryHDU(), table]).writeto(kinds["table"])
    tn.calibrate(tn.read(p45_folder)).write(kinds["calibration"])
    kinds["no TOML"].write_text("a = [1\n")
    kinds["plan"].write_text("cycles = 2\n")
    tn.write_stiffness(p45_matrix()[0], kinds["stiffness"])
    return kinds | {
        "campaign": p45_folder,
        "cycle": p45_folder / "bare-001.fits",
        "below a file": kinds["text"] / "x.fits",
    }


# What a command takes in the place of PATH, beside what the fixture has not.
COMMANDS = {
    "calibrate PATH": {"campaign", "stiffness"},
    "info PATH": {"campaign", "cycle", "stiffness", "calibration"},
    "report PATH -o OUT.html": {"campaign", "cycle", "stiffness", "calibration"},
    "report ALPHA PATH -o OUT.html": {"calibration", "campaign"},  # which names ALPHA
    "figures PATH -o OUT": {"campaign", "stiffness", "calibration"},
    "track PATH": set(),
    "track ALPHA PATH": set(),
    "recalibrate PATH --known ALPHA --actuators 3": {"campaign", "cycle"},
    "recalibrate CAMPAIGN --known PATH --actuators 3": {"calibration"},
    "modes PATH": {"campaign", "stiffness"},
    "modes CAMPAIGN --calibration PATH": {"calibration"},
    "plan PATH": set(),
    "acquire PATH -o OUT": set(),
    "simulate PATH -o OUT": set(),
    "prove PATH": {"cycle", "stiffness"},
    "mirrors PATH": set(),
    "calibrate STIFFNESS --method reciprocity --mirror PATH": set(),
}
# Which kinds of path are tried: all where a kind of file is read, of other commands a few.
READERS = "calibrate PATH", "track PATH", "plan PATH", "mirrors PATH"
FEW = {"empty folder", "nothing", "cycle", "text", "table", "calibration", "plan", "campaign"}
OUTPUTS = {  # where a command would write: a folder that is not its own, below a file, nowhere
    "calibrate CAMPAIGN -o PATH --overwrite": (),
    "figures ALPHA -o PATH --overwrite": ("empty folder",),
    "report ALPHA -o PATH --overwrite": (),
    "modes CAMPAIGN -o PATH --overwrite": (),
    "modes CAMPAIGN --figures PATH --overwrite": ("empty folder",),
    "recalibrate CAMPAIGN --known ALPHA --actuators 3 -o PATH --overwrite": (),
    "plan --new -o PATH --overwrite": (),
    "simulate p45 --cycles 1 -o PATH --overwrite": ("empty folder", "campaign"),
    "mirrors p45 --plot -o PATH --overwrite": (),
}


def refused(inside, monkeypatch, tmp_path, command, path, paths):
    """Run a command line with a path in it; return the one line of its refusal."""
    known = {"PATH": path, "ALPHA": paths["calibration"], "CAMPAIGN": paths["campaign"],
             "STIFFNESS": paths["stiffness"]}  # fmt: skip
    monkeypatch.chdir(tmp_path)
    error = inside.refuses(*(known.get(word, word) for word in command.split()))
    assert str(path) in error
    assert "; " in error  # the remedy
    assert not list(tmp_path.iterdir())
    return error


@pytest.mark.parametrize("command", COMMANDS)
def test_a_path_of_another_kind_is_refused_in_a_line_that_names_it(
    inside, monkeypatch, tmp_path, paths, command
):
    kinds = paths.keys() if command in READERS else FEW
    for kind in kinds - COMMANDS[command]:
        refused(inside, monkeypatch, tmp_path, command, paths[kind], paths)


@pytest.mark.parametrize("command", OUTPUTS)
def test_an_output_that_cannot_be_is_refused_in_a_line_that_names_it(
    inside, monkeypatch, tmp_path, paths, command
):
    kinds = {"empty folder", "folder of text", "campaign", "below a file"} - {*OUTPUTS[command]}
    for path in (*(paths[kind] for kind in kinds), tmp_path / "nowhere" / "x.fits"):
        refused(inside, monkeypatch, tmp_path, command, path, paths)


def test_a_column_of_zeros_in_one_file_is_no_crash():
    """The prints of rows are in single precision, where 1e-300 is nothing."""
    first = np.arange(45) == 0
    files = changed(lambda c: replace(c, force=np.where(first, 0.0, c.force)), ONE)()
    refused = pytest.raises(TooManyOutliers, match="not one of its rows fits the other files")
    with np.errstate(divide="raise", invalid="raise"), refused:
        screen_campaign(Campaign(tuple(files)))
