"""The entry of the experiments in a study: a campaign, or one of the laboratories."""

from pathlib import Path
from typing import Any

from pydantic import create_model, model_validator

from hsed_jax.laboratories.kinds import KINDS
from hsed_jax.laboratories.kinds.base import AbstractLaboratoryEntry
from hsed_jax.laboratories.kinds.virtual import VirtualEntry
from hsed_jax.sections import Section

_LABORATORIES: Any = {name: (section | None, None) for name, section in KINDS.items()}


class ExperimentsEntry(create_model("ExperimentsEntry", __base__=Section, **_LABORATORIES)):
    """Where measurements come from: a campaign, or one of the laboratories (`hsed_jax.laboratories.kinds`)."""

    campaign: str | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "ExperimentsEntry":
        sources = ("campaign", *KINDS)
        given = [name for name in sources if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(f"give exactly one of {', '.join(sources)}; given are {', '.join(given) or 'none'}")
        return self

    @property
    def kind(self) -> str:
        """The key that is given."""
        return next(name for name in ("campaign", *KINDS) if getattr(self, name) is not None)

    @property
    def laboratory(self) -> AbstractLaboratoryEntry | None:
        """The laboratory; None if the experiments are already measured."""
        return None if self.campaign is not None else getattr(self, self.kind)

    @property
    def specimen(self) -> VirtualEntry | None:
        """The virtual specimen; None with another laboratory."""
        return self.laboratory if isinstance(self.laboratory, VirtualEntry) else None

    @property
    def described(self) -> str:
        """Its kind, for a title."""
        return f"the campaign {self.campaign}" if self.laboratory is None else self.laboratory.described

    def located(self, folder: Path) -> "ExperimentsEntry":
        """The same with absolute paths: written elsewhere, a relative path would lead elsewhere."""
        if self.laboratory is None:
            assert self.campaign is not None
            return self.model_copy(update={"campaign": str((folder / self.campaign).resolve())})
        return self.model_copy(update={self.kind: self.laboratory.located(folder)})
