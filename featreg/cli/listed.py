"""What can be listed: a name of some kind, what it is, its parameters and their declarations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from featreg.errors import FeatregError

if TYPE_CHECKING:
    from featreg.runtime.parameters import Parameter

KINDS = ("detector", "descriptor", "nearest", "matcher", "filter", "model", "method")


@dataclass(frozen=True)
class Item:
    """One name of one kind; `unavailable` is why it cannot be used, with the cure."""

    kind: str
    name: str
    summary: str
    unavailable: str

    def parameters(self) -> dict[str, Any]:
        """Name -> default; of a method also each part's, as a mapping under its role."""
        from featreg import registry

        if self.kind != "method":
            return dict(registry.entry(self.kind, self.name).parameters)
        from featreg.pipeline.assembly import assemble

        choice = registry.presets()[self.name].methods
        try:
            return {"methods": list(choice)} if choice else dict(assemble(self.name).parameters)
        except FeatregError:
            return {}

    def declared(self) -> dict[str, Parameter]:
        """Name -> what is declared of it; of a method as "part.name", which is also how it is set."""
        from featreg import registry

        if self.kind != "method":
            return dict(registry.entry(self.kind, self.name).declared)
        from featreg.pipeline.locate import Locate
        from featreg.pipeline.refine import Refine
        from featreg.pipeline.trust import Limits
        from featreg.runtime.parameters import declared

        preset = registry.presets()[self.name]
        if preset.methods:
            return {}  # those of each method are listed under its own name
        parts = {role: registry.entry(role, part.name).declared for role, part in preset.parts}
        parts |= {part.name: registry.entry("filter", part.name).declared for part in preset.filters}
        parts |= {"locate": declared(Locate), "refine": declared(Refine), "trust": declared(Limits)}
        return {f"{part}.{key}": value for part, known in parts.items() for key, value in known.items()}
