"""The paper's structure and simulator, the shared data, the reference table, and a browser: what several test files use."""

import gc
import os
import shutil
import signal
from pathlib import Path

import jax
import jax.numpy as jnp
import pandas as pd
import pytest
import shape_checks
from builders.places import SHARED, TESTS
from observations import Observed

import hsed_jax
from hsed_jax.backend import limit_threads, prepare
from hsed_jax.errors import UserError
from hsed_jax.laboratories.opensees import require_openseespy
from hsed_jax.physics.effects import EFFECTS
from hsed_jax.physics.excitations.near_fault_pulse import NearFaultPulse
from hsed_jax.physics.scales import Scales
from hsed_jax.physics.simulator import Conditions, Parametrised, Simulator, Timeline
from hsed_jax.physics.structures import ModalDamping, Spring, Structure

# Many tests build no study.
prepare()
limit_threads()

# A process may map 65 530 pieces of memory on Linux, a compiled program is several, and beyond that the compiler crashes.
MOST_PIECES = 25_000

REFERENCE = TESTS / "data" / "reference_quantities.csv"
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # A shell's background jobs ignore Ctrl-C, and so would the processes that the tests interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Default tests take most of their time in compiling small cases that run for milliseconds.
QUICK = "JAX_DISABLE_MOST_OPTIMIZATIONS"


def pytest_addoption(parser) -> None:
    """What `docs/verification.py` asks for."""
    parser.addoption("--measure", action="store_true", help="report the rows of the verification manual")


def pytest_configure(config) -> None:
    """Default tests compile without XLA's optimisations, but for those of files marked `optimised`, and so do their processes.

    So do those of `.ci/whole`.  The slow ones run for long and keep them, and so does a run with
    `JAX_DISABLE_MOST_OPTIMIZATIONS=0`.
    """
    # Tracing makes many objects that live: without this, looking for those that do not is a tenth of all.
    gc.freeze()
    gc.set_threshold(100_000, 20, 100)
    if "not slow" in config.option.markexpr and QUICK not in os.environ:
        os.environ[QUICK] = "1"
        jax.config.update(QUICK.lower(), True)


@pytest.fixture(scope="module", autouse=True)
def optimised(request):
    """A file marked `optimised` compares many digits or simulates for long, and is compiled as users' programs are."""
    if request.node.get_closest_marker("optimised") is None or os.environ.get(QUICK) != "1":
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(QUICK)
        jax.config.update(QUICK.lower(), False)
        jax.clear_caches()
        yield
    jax.config.update(QUICK.lower(), True)
    jax.clear_caches()


@pytest.fixture(scope="session")
def openseespy() -> None:
    """OpenSees, without which what asks for it is skipped."""
    try:
        require_openseespy()
    except UserError as error:
        pytest.skip(str(error))


@pytest.fixture(autouse=True)
def checked():
    """Shapes are checked anew in every test."""
    shape_checks.begin_test()


@pytest.fixture
def observed(request):
    """Compares an error with its tolerance, and keeps it for the verification manual: `observations.py`."""
    return Observed(request.node)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """A test that passed hands over its rows of the verification manual."""
    result = yield
    rows = item.funcargs.get("observed")
    if isinstance(rows, Observed):
        rows.finish(item.config.getoption("--measure"))
    return result


@pytest.fixture(scope="module", autouse=True)
def few_programs():
    """Compiled programs of earlier files of tests are dropped where there are many."""
    yield
    pieces = Path("/proc/self/maps")
    if pieces.is_file() and len(pieces.read_bytes().splitlines()) > MOST_PIECES:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of measured data, beside the repository."""
    if not SHARED.is_dir():
        pytest.skip(f"there is no folder {SHARED}")
    return SHARED


@pytest.fixture(scope="session")
def reference_table() -> pd.DataFrame:
    """600 independent simulations (DOP853, rtol 1e-12, events at the kinks), C formed with each row's own A."""
    return pd.read_csv(REFERENCE).astype({"A": float, "beta": float})


@pytest.fixture(scope="session")
def paper_structure() -> Structure:
    """Two masses, each on its spring to the ground, the specimen between them; 5 % damping, formed with A_ref."""
    springs = (Spring((None, 0), 4e5), Spring((None, 1), 1e6))
    return Structure((8e3, 9e3), springs, ((0, 1),), ModalDamping(0.05, specimen_stiffness=5e5))


@pytest.fixture(scope="session")
def paper_excitation() -> Parametrised:
    """The near-fault pulse with the paper's inputs."""
    return Parametrised(NearFaultPulse, (("V_P", "V_P"), ("T_P", "T_P")))


@pytest.fixture(scope="session")
def paper_simulator(paper_structure, paper_excitation):
    """A factory: the paper's simulator (10 s, γ = 0, n = 1), with any field changed by keyword, effects by name.

    The characteristic energy is 1 J, so that `stiffness_degradation.delta` is the paper's η [1/J].
    """

    def make(effects=(), **changes) -> Simulator:
        fields = {
            "structure": paper_structure,
            "excitation": paper_excitation,
            "timeline": Timeline(step=1 / 64, steps=640),
            "constants": (("gamma", 0.0), ("n", 1.0)),
            "scales": Scales(),
        }
        return Simulator(effects=EFFECTS.only(effects), **{**fields, **changes})

    return make


@pytest.fixture(scope="session")
def pulse_conditions():
    """A factory: conditions of an experiment, or of many, from V_P [m/s] and T_P [s]."""

    def make(V_P, T_P) -> Conditions:
        return Conditions({"V_P": jnp.asarray(V_P, float), "T_P": jnp.asarray(T_P, float)})

    return make


def pytest_report_header() -> str:
    """Where the package under test lies."""
    return f"hsed_jax: {Path(hsed_jax.__file__).parent}"


@pytest.fixture(scope="module")
def browser():
    """Chromium, driven by Playwright; skips where one of them is missing."""
    sync_api = pytest.importorskip("playwright.sync_api")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("there is no Chromium on the path")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        yield browser
        browser.close()
