"""Where the files are that tests read."""

from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
ROOT = TESTS.parent
SHARED = ROOT.parent / "shared"
DATA = SHARED / "data"
"""Measured campaigns and ground motions; where they are absent, tests skip."""
