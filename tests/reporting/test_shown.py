"""In which unit numbers are shown: as the campaign declares them, in checks, places, figures and the report's numbers."""

from dataclasses import replace

import numpy as np
import pytest
from builders.misfits import histories

from hsed_jax.criticism.locate import Place
from hsed_jax.measurements import Campaign, Channel, Experiment, Record, check_campaign
from hsed_jax.physics.display import amount, shown, shown_in
from hsed_jax.physics.pairs import ELONGATION_AND_FORCE
from hsed_jax.reporting.misfit_figures import loops

INCH, KIP = 0.0254, 4448.2216152605
CHANNELS = {"elongation": Channel("elongation", "inch"), "force": Channel("force", "kip")}


def in_inches(**more):
    return Campaign("frame", "displacement", channels=CHANNELS | more)


def test_what_is_declared_is_shown_and_what_follows_from_it():
    pair = in_inches().pair
    assert pair == ELONGATION_AND_FORCE
    for name in ("elongation", "peak_elongation", "storey2.elongation"):
        assert shown(pair, name, np.asarray([3.0])) == (INCH, "inch")
    for name in ("force", "peak_force"):
        factor, unit = shown(pair, name, np.asarray([3.0e6]))
        assert (factor, unit) == (pytest.approx(KIP), "kip")
    assert shown_in(pair, "m", np.asarray([0.1])) == (INCH, "inch")
    assert shown_in(pair, "m/s", np.asarray([0.1])) == (INCH, "inch/s")
    assert shown_in(pair, "N/m", np.asarray([1e6])) == (pytest.approx(KIP / INCH), "kip/inch")
    assert amount(pair, "elongation", 0.0508) == "2 inch"
    # Nobody declares these, and the masses are no part of the specimen.
    assert shown(pair, "dissipated_energy", np.asarray([3e4])) == (1e3, "kJ")
    assert shown(pair, "displacement_1", np.asarray([0.1])) == (1e-3, "mm")


def test_plain_units_take_a_readable_prefix_and_a_quantity_its_own_unit():
    plain = {"elongation": Channel("elongation", "m"), "force": Channel("force", "N")}
    pair = Campaign("frame", "displacement", channels=plain).pair
    assert shown(pair, "force", np.asarray([2.5e5])) == (1e3, "kN")
    assert shown(pair, "elongation", np.asarray([0.02])) == (1e-3, "mm")
    assert shown_in(pair, "N/m", np.asarray([2e6])) == (1e6, "MN/m")
    both = replace(in_inches(), quantities={"peak_force": Channel("peak_force", "kN")}).pair
    assert shown(both, "peak_force", np.asarray([2.5e6])) == (1e3, "kN")
    turned = {"elongation": Channel("elongation", "deg"), "force": Channel("force", "kip*inch")}
    factor, unit = shown(Campaign("joint", "displacement", channels=turned).pair, "elongation", np.asarray([0.1]))
    assert (factor, unit) == (pytest.approx(np.pi / 180), "deg")


def test_a_check_says_jumps_and_plateaus_in_declared_units():
    elongation = np.delete(0.1 * np.sin(np.linspace(0, 30, 2000)), slice(900, 960))
    record = Record(np.arange(elongation.size, dtype=float), {"elongation": elongation, "force": 1e6 * elongation})
    found = check_campaign(in_inches().add(Experiment("E1", record=record)))
    (jump,) = [finding for finding in found if finding.kind == "jump"]
    size = np.abs(np.diff(elongation)).max() / INCH
    assert f"jumps by {size:.3g} inch" in jump.message and " m " not in jump.message


def test_a_place_of_the_misfit_is_said_in_declared_units():
    place = Place("amplitude", "above", 0.0508, "m", 0.5, 0.2, 0.2, 0.1, 0.1, pair=in_inches().pair)
    assert "at elongations above 2 inch" in place.sentence
    fast = replace(place, coordinate="speed", unit="m/s")
    assert "at elongation rates above 2 inch/s" in fast.sentence
    plain = replace(place, pair=ELONGATION_AND_FORCE)
    assert "at elongations above 50.8 mm" in plain.sentence


def test_figures_have_the_declared_units_on_their_axes():
    campaign, comparison, _ = histories(2, 0, 40)
    told = {name: replace(channel, unit=CHANNELS[name].unit) if name in CHANNELS else channel
            for name, channel in campaign.channels.items()}  # fmt: skip
    picture = loops(comparison, replace(campaign, channels=told))
    assert picture is not None
    panel = picture.figure.axes[0]
    assert "[inch]" in panel.get_xlabel() and "[kip]" in panel.get_ylabel()
    largest = max(np.nanmax(np.abs(line.get_xdata())) for line in panel.lines)
    known = max(np.abs(e.record["elongation"]).max() for e in campaign if e.record is not None)
    assert largest == pytest.approx(known / INCH, rel=0.2)
