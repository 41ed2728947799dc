"""The package's own diagnosis."""

from __future__ import annotations

from deepkoco.diagnose import diagnose
from deepkoco.systems import ExtendedSystem
from experiments.studies.diagnosis.hidden_cause.entrants.as_given import simulation_of
from experiments.studies.diagnosis.hidden_cause.kinds import NOTHING, UNKNOWN
from experiments.studies.diagnosis.hidden_cause.questions import Answer, Handed


class DeepKoCo:
    """`deepkoco.diagnose` with its defaults. Its first cause with its class; "insufficient" counts as nothing."""

    name = "deepkoco"

    def answer(self, handed: Handed) -> Answer:
        """Diagnose the log."""
        found = diagnose(
            list(handed.log), handed.system, healthy=list(handed.healthy), seed=handed.seed % 2**31
        )
        model = found.model if isinstance(found.model, ExtendedSystem) else ExtendedSystem(found.model, ())
        causes = (
            [c for c in found.causes if c.name != UNKNOWN] if found.verdict in ("cause", "ambiguous") else []
        )
        further = "; ".join(c.name for c in causes[1:])
        note = f"{found.verdict}, chi2 {found.chi2_before:.3g} -> {found.chi2_after:.3g}"
        note += f", also {further}" if further else ""
        if not causes:
            name = UNKNOWN if found.verdict == "unknown" else NOTHING
            return Answer(name, (), simulation_of(model, {}), note)
        first = causes[0]
        same = tuple(f"changed({m.name})" for m in first.same_as)
        return Answer(first.name, (*first.members, *same), simulation_of(model, {}), note)
