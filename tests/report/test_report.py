"""The report says what holds: verdicts, evidence, changes; and takes no name for markup."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from importlib import resources

import numpy as np
import pytest
from bokeh.resources import Resources

import truenewton as tn
from helpers import report_data
from helpers.balanced import arms_of, p45_campaign, p45_matrix
from helpers.report_data import HOSTILE, changed_by, hostile_campaign
from truenewton.calibration.layers import layers_of
from truenewton.calibration.methods import calibrate
from truenewton.comparison.calibrations import compare_calibrations
from truenewton.errors import CampaignMismatch, UnknownName
from truenewton.estimation.findings.estimate import Diagnosis
from truenewton.records.campaign import Campaign
from truenewton.records.cycle import Source
from truenewton.report.findings import investigate
from truenewton.report.page.page import page, what_to_look_at, worst_residuals
from truenewton.report.verdict import headline_of
from truenewton.statics.arms import external_load

GOLDEN = {
    "fine": """\
Sound. Alpha of all 14 actuators of TEST has a typical error of 0.019 %. The stated\
 errors are valid.
alpha: 0.73445 .. 1.02068 (true N / commanded N; lowest: actuator 1, highest: 3)
typical error of alpha: 0.019 % (E_ALPHA, one sigma)
common scale: 0.0069 % (E_SYST, from the weights)
Nothing needs to be done.""",
    "scale_limited": """\
Usable. Alpha of all 14 actuators of TEST has a typical error of 1.7 %. Alpha can be used within\
 the limits below.
alpha: 0.734 .. 1.021 (true N / commanded N; lowest: actuator 1, highest: 3)
typical error of alpha: 1.7 % (E_ALPHA, one sigma)
common scale: 1.7 % (E_SYST, from the weights)
- The uncertainty of the common scale is 1.7 %, and nearly all of it comes from the weight of\
 'ring A'. If you weigh 'ring A' to 0.5 mN, the scale error falls to 0.17 %. If you use a tilt of\
 60 ± 0.1 degrees as the load, the scale error is 0.35 %.""",
    "with_outliers": """\
Usable. Alpha of all 14 actuators of TEST has a typical error of 0.019 %. Alpha can be used within\
 the limits below.
alpha: 0.73447 .. 1.02071 (true N / commanded N; lowest: actuator 1, highest: 3)
typical error of alpha: 0.019 % (E_ALPHA, one sigma)
common scale: 0.0069 % (E_SYST, from the weights)
- 3 rows did not fit and were left out; the farthest: cycle 1 row 3, 372 sigma from its repeats,\
 mainly because of actuator 6. Check the residuals, and any actuator that is named repeatedly.""",
    "one_load": """\
No alpha. These data of TEST cannot give alpha.
- There is only one load, 'bare', so the common scale is not determined. Add cycles under a load of\
 another known weight.""",
}


@pytest.mark.parametrize("name", GOLDEN)
def test_the_verdict_in_words(name):
    assert "\n".join(headline_of(investigate(getattr(report_data, name)())).lines()) == GOLDEN[name]


def test_a_disabled_actuator_is_named():
    judged = headline_of(investigate(report_data.fine(disabled=(4,))))
    assert "Alpha of 13 of the 14 actuators of TEST (actuator 5 disabled)" in judged.sentence


def test_a_fit_worse_than_its_noise_is_used_with_care():
    """Readings whose repeats agree to 0.1 mN, but whose shapes are out of balance by far more."""
    campaign = report_data.fine()
    wrong = 0.002 * np.random.default_rng(1).standard_normal(campaign.cycles[0].force.shape)
    bent = Campaign(tuple(replace(c, force=c.force + wrong) for c in campaign.cycles))
    judged = headline_of(investigate(bent))
    assert judged.title == "Doubtful"
    assert any("the model does not fit" in each.fault for each in judged.advice)
    # As uncertain as four repeats of that noise would be.
    sound, found = investigate(campaign).calibration, investigate(bent).calibration
    assert np.mean(found.statistical_error / sound.statistical_error) > 10
    sigmas = (found.alpha - sound.alpha) / found.statistical_error
    assert np.sqrt(np.mean(sigmas**2)) < 2


@pytest.fixture(scope="module")
def p45():
    return investigate(p45_campaign(), diameter=2.13, efficiency=0.51)


def test_residuals_are_those_of_the_balance_itself(p45):
    """Row by row: A (alpha c) + k with B and torques as found, whitened by its own covariance."""
    c, data, residuals = p45.calibration, p45.data, p45.evidence.residuals
    a = arms_of(c.layout) * c.alpha
    variance = p45.evidence.actuator_noise**2
    s = np.linalg.inv((a * variance) @ a.T)
    expected = []
    for cycle, place in zip(data.cycles, data.load_index, strict=True):
        weight = data.effective_weights[place]
        k = external_load(weight, c.bias_force, c.torque_y[place], c.torque_x[place])
        expected += [float(np.sqrt((a @ f + k) @ s @ (a @ f + k) / 3)) for f in cycle.force]
    assert residuals.after == pytest.approx(np.array(expected), rel=1e-2, abs=5e-3)
    assert np.sqrt(np.mean(residuals.after**2)) == pytest.approx(1.0, abs=0.03)  # 1 mN, 2160 rows
    assert p45.evidence.actuator_noise == pytest.approx(np.full(45, 1e-3), rel=0.15)
    assert p45.evidence.actuator_residual == pytest.approx(np.ones(45), rel=0.06)


def test_the_balance_before_is_that_of_commanded_forces(p45):
    data = p45.data
    forces = np.concatenate([c.force for c in data.cycles if c.load.name == "bare"])
    total = forces @ data.layout.nz
    [line] = [line for line in p45.evidence.balance if line.what == "force, bare"]
    assert line.before == pytest.approx(1e3 * total.std(), rel=1e-9)
    assert line.unit == "mN"
    assert line.after == pytest.approx(line.noise, rel=0.1)  # nothing but noise is left
    assert line.noise == pytest.approx(np.sqrt(np.sum(p45.calibration.alpha**2)), rel=0.05)


def test_leverage_is_that_of_the_readings(p45):
    layers = layers_of(p45.calibration, p45.evidence)
    [layer] = [layer for layer in layers if layer.key == "leverage"]
    assert layer.values.sum() == pytest.approx(3.0)
    read_back = replace(p45.calibration, diagnosis=Diagnosis())
    [even] = [one for one in layers_of(read_back) if one.key == "leverage"]
    assert even.values == pytest.approx(layer.values, rel=0.4)  # noise taken as even
    assert even.values.sum() == pytest.approx(3.0)


def test_a_changed_actuator_stands_out_by_as_many_sigmas():
    found = compare_calibrations(*changed_by(12.0))
    assert found.ratio == pytest.approx(1.02)
    assert found.sigmas[6] == pytest.approx(12.0, rel=1e-6)
    assert np.abs(np.delete(found.sigmas, 6)).max() < 1e-9
    assert found.changed.tolist() == [6]
    assert found.limit == pytest.approx(3.39, abs=0.02)  # two-sided, 1 % over 14: tables of erfc
    judged = headline_of(found)
    assert judged.title == "Changed"
    assert judged.advice[0][0] == "changed: actuator 7"
    assert found.layers[0].limits[1] == pytest.approx(3 * found.limit)
    assert "12.0 sigma" in page(found)


def test_what_is_common_to_all_is_no_change():
    found = compare_calibrations(*changed_by(0.0))
    assert headline_of(found).title == "No change"
    scale = np.nanmedian(found.one.systematic_error / found.one.alpha)
    assert found.ratio_error == pytest.approx(1.02 * np.sqrt(2) * scale)
    named = replace(found.one, sources=(Source("bare.fits", "0" * 64, 1, 0),))
    assert "use the same files" in headline_of(compare_calibrations(named, named)).advice[0][0]


def test_chance_alone_changes_nothing():
    """Two campaigns of one mirror: the sigmas scatter by about one."""
    one = calibrate(p45_campaign(2))
    other = calibrate(Campaign(p45_campaign(4).cycles[2:4] + p45_campaign(4).cycles[6:8]))
    found = compare_calibrations(one, other)
    assert 0.5 < np.std(found.sigmas) < 1.6
    assert not found.changed.size


def test_two_mirrors_are_not_compared_and_unknown_figures_not_drawn(p45):
    with pytest.raises(CampaignMismatch, match="not of the same actuators"):
        compare_calibrations(p45.calibration, changed_by(0.0)[0])
    with pytest.raises(UnknownName, match="choose map-alpha, map-e-alpha"):
        p45.plot("colour")


class Reader(HTMLParser):
    """Gathers tags, and the text of the page without its scripts and styles."""

    def __init__(self):
        super().__init__()
        self.tags, self.text, self.scripts, self.within = [], [], [], ""

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self.within = tag if tag in ("script", "style") else ""

    def handle_endtag(self, tag):
        self.within = ""

    def handle_data(self, data):
        (self.scripts if self.within == "script" else self.text).append(data)


def test_hostile_names_come_out_as_text():
    reader = Reader()
    reader.feed(page(investigate(hostile_campaign()), command=f"truenewton report '{HOSTILE}'"))
    assert {tag for tag, _ in reader.tags if tag == "script"} == {"script"}
    assert sum(tag == "script" for tag, _ in reader.tags) == 4  # tables, Bokeh, payload, ours
    assert all("onerror" not in attributes for _, attributes in reader.tags)
    assert all(re.fullmatch(r"still-[a-z-]+", a["id"]) for tag, a in reader.tags if tag == "img")
    text = "".join(reader.text)
    assert "<script>window.hit=1</script>\"'&\n</script><img src=x onerror=window.hit=1>" in text
    assert "{{7*7}}" in text
    [payload] = [one for one in reader.scripts if one.startswith('{"documents"')]
    assert not set("<>&'") & set(payload)
    assert json.loads(payload)["layers"]
    assert '0<img src=x onerror=window.hit=1>".fits' in text


def test_no_alpha_means_no_alpha_on_the_page():
    for name in ("one_load", "too_few_shapes"):
        text = page(investigate(getattr(report_data, name)()))
        assert "No alpha" in text
        assert "Map of the mirror" not in text
        assert "Temperatures and times" in text


def test_the_page_holds_all_it_needs(p45):
    reader = Reader()
    reader.feed(page(p45, command="truenewton report p45 -o r.html"))
    for tag, attributes in reader.tags:
        assert "src" not in attributes, tag
        assert attributes.get("href", "#").startswith("#"), tag
        assert attributes.get("xlink:href", "#").startswith(("#", "data:image/png;")), tag
    text = "".join(reader.text)
    text = text[text.index("Usable") :]  # after the contents
    parts = ("Usable", "What to do", "Map of the mirror", "What to look at", "Alpha by ring",
             "Error budget", "Residuals by shape and cycle", "Singular values",
             "The balance before and after",
             "Stiffness modes", "Turbulence", "Dissipation", "Temperatures and times",
             "Command to reproduce this page")  # fmt: skip
    places = [text.find(words) for words in parts]
    assert min(places) >= 0, parts[np.argmin(places)]
    assert places == sorted(places)
    assert "truenewton report p45 -o r.html" in text


def test_worst_residuals_and_bad_actuators_are_listed_with_their_ids(p45):
    alpha = p45.calibration.alpha.copy()
    alpha[16] = 0.01
    found = tn.Finding(code=tn.Code.ALPHA_ZERO, actuators=(17,))
    c = replace(p45.calibration, alpha=alpha, effects=(found,))
    layers = layers_of(c, p45.evidence)
    look = what_to_look_at(c, layers, worst_residuals(replace(p45, calibration=c)))
    rows = {what: where for what, where, _ in look.tables[0].rows}
    residuals = p45.evidence.residuals
    worst = int(np.argmax(residuals.after))
    place = f"shape {residuals.signed_shape[worst]} of cycle {residuals.cycle[worst] + 1} "
    assert rows["rows with the largest imbalance"].startswith(place)
    assert rows["outliers: alpha"].startswith("17 (")
    assert rows["named in findings"] == "17 (1)"
    disabled = investigate(report_data.fine(disabled=(4,))).calibration
    look = what_to_look_at(disabled, layers_of(disabled), ())
    assert look.tables[0].rows[0][:2] == ("disabled actuators", "5")


def test_a_page_of_a_large_mirror_is_little_longer_than_bokeh():
    """Of 1002 actuators half a megabyte; of 5,352, see docs/report.md, five times that."""
    text = page(investigate(report_data.large(1002)))
    bokeh = sum(len(part) for part in Resources(mode="inline", components=["bokeh"]).js_raw)
    assert bokeh < len(text.encode()) < bokeh + 5e5


def test_the_command_takes_data_a_calibration_and_a_pair(inside, p45_folder, tmp_path):
    out = inside.prints("report", p45_folder, "-o", tmp_path / "one.html")
    assert out.startswith("Usable. Alpha of all 45 actuators of P45 has a typical error")
    assert f"truenewton report {p45_folder}" in (tmp_path / "one.html").read_text()
    for method in ("ml", "svd"):
        inside("calibrate", p45_folder, "--method", method, "-o", tmp_path / f"{method}.fits")
    inside.prints("report", tmp_path / "ml.fits", "-o", tmp_path / "two.html")
    assert (
        "does not contain them. To show them, give the cycles"
        in (tmp_path / "two.html").read_text()
    )
    code, _, err = inside("report", p45_folder, "--calibration", tmp_path / "ml.fits",
                              "-o", tmp_path / "again.html")  # fmt: skip
    assert (code, err) == (0, "")
    same, other = ((tmp_path / f"{name}.html").read_text() for name in ("one", "again"))
    assert "--calibration" in other
    for part in ("residuals", "balance", "modes", "times"):
        words = [text.split(f'id="title-{part}"')[1].split("</section>")[0].split("<figcaption")[1]
                 for text in (same, other)]  # fmt: skip
        assert words[0] == words[1]
    pair = (tmp_path / "svd.fits", tmp_path / "ml.fits")
    assert "use the same files" in inside.prints("report", *pair, "-o", tmp_path / "pair.html")
    assert "exists already" in inside.refuses("report", p45_folder, "-o", tmp_path / "one.html")
    err = inside.refuses("report", p45_folder, "-o", tmp_path / "x.html", "--method", "no")
    assert "there is no method 'no'" in err


def test_a_matrix_with_its_calibration_and_actuators_with_texts(inside, tmp_path):
    """The command that `calibrate` names after a matrix; a calibration is a page, too."""
    matrix = p45_matrix()[0]
    texts = np.array([f"B{i}" for i in matrix.layout.id])
    matrix = replace(matrix, layout=replace(matrix.layout, number=texts))
    tn.write_stiffness(matrix, tmp_path / "k.fits")
    calibration = tn.calibrate(tmp_path / "k.fits", "ml")
    calibration.write(tmp_path / "a.fits")
    command = "report", tmp_path / "k.fits", "--calibration", tmp_path / "a.fits"
    assert "(B" in inside.prints(*command, "-o", tmp_path / "one.html")
    tn.write_report(tmp_path / "two.html", calibration)
    assert "17 (B17)" in (tmp_path / "two.html").read_text()
    with pytest.raises(TypeError, match="takes the name of the page first"):
        tn.write_report(calibration, tmp_path / "two.html")


def test_a_calibration_of_other_files_gives_no_page(p45):
    with pytest.raises(CampaignMismatch, match="is of TEST, the data of P45"):
        investigate(p45.data, calibration=changed_by(0.0)[0])
    other = replace(p45.calibration, sources=(Source("bare.fits", "0" * 64, 1, 0),))
    cycles = (replace(c, source=Source(c.name, "1" * 64, 1, 0)) for c in p45.data.cycles)
    with pytest.raises(CampaignMismatch, match="was not used for the calibration"):
        investigate(Campaign(tuple(cycles)), calibration=other)


def test_the_evidence_is_that_of_all_actuators_though_some_are_excluded():
    """The forces of an excluded actuator are part of the balance."""
    data = report_data.fine()
    every, some = (investigate(data, calibration=calibrate(data, exclude=ids)).evidence
                   for ids in ([], [3]))  # fmt: skip
    assert some.residuals.after == pytest.approx(every.residuals.after, rel=1e-9)
    assert [line.after for line in some.balance] == pytest.approx(
        [line.after for line in every.balance], rel=1e-9
    )


def test_an_excluded_actuator_whose_force_is_0_is_no_part_of_the_evidence():
    without = report_data.fine(disabled=(2,))
    on = np.ones(14, dtype=bool)
    cycles = (replace(c, force=np.nan_to_num(c.force), layout=replace(c.layout, enabled=on))
              for c in without)  # fmt: skip
    data = Campaign(tuple(cycles))
    found = investigate(data, calibration=calibrate(data, exclude=[3])).evidence
    expected = investigate(without).evidence.residuals.after
    assert found.residuals.after == pytest.approx(expected, rel=1e-9)


def test_actuators_that_findings_name_are_a_layer_of_the_map(p45):
    found = replace(p45.calibration, effects=(
        tn.Finding(code=tn.Code.ACTUATOR_MISFIT, actuators=(3, 17), corrected=True, remedy="look"),
    ))  # fmt: skip
    layers = {layer.key: layer for layer in layers_of(found)}
    assert np.flatnonzero(layers["findings"].values).tolist() == [2, 16]


def test_the_csv_of_the_page_names_rings_as_its_table_does():
    script = resources.files("truenewton.report.page").joinpath("templates/report.js").read_text()
    [heads] = re.findall(r"const heads = \[(.*) \.\.\.layers", script)
    [fields] = re.findall(r"const fields = \[(.*) \.\.\.layers", script)
    assert fields == '"id", "ring", "x", "y",'
    assert heads == '"ID", "RING", "X_mm", "Y_mm",'
