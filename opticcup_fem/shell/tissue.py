"""What a shell is made of: the layers of its regions and how each of them grows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from opticcup_fem.errors import CaseError
from opticcup_fem.shell.growth import GrowthLaw
from opticcup_fem.shell.section import Layer, Section


@dataclass(frozen=True)
class Tissue:
    """Layers and growth of a shell, for both models.

    Attributes:
        sections: Section of every region of the mesh, by the region's name.
        laws: Growth law of every layer, by the layer's name.
    """

    sections: Mapping[str, Section]
    laws: Mapping[str, GrowthLaw]

    def __post_init__(self) -> None:
        """Refuse layers that nothing says the growth of, and growth of layers that are not there.

        Raises:
            CaseError: Which they are.
        """
        layers = {layer.name for section in self.sections.values() for layer in section.layers}
        if without := sorted(layers - set(self.laws)):
            raise CaseError(f"no growth law is given for the layer {', '.join(without)}")
        if unknown := sorted(set(self.laws) - layers):
            raise CaseError(
                f"a growth law is given for {', '.join(unknown)}, and the layers are "
                f"{', '.join(sorted(layers))}"
            )

    def with_growth(self, **laws: GrowthLaw) -> Tissue:
        """Return the tissue with other laws for the layers named.

        Raises:
            CaseError: There is no such layer.
        """
        return replace(self, laws={**self.laws, **laws})

    def with_layers(self, region: str, layers: Sequence[Layer], **laws: GrowthLaw) -> Tissue:
        """Return the tissue with other layers in a region.

        Args:
            region: Name of the region.
            layers: Its layers, the innermost first.
            laws: Growth laws of layers that had none, by name; the others keep theirs.

        Raises:
            CaseError: There is no such region, or a layer has no law.
        """
        if region not in self.sections:
            raise CaseError(f"there is no region {region!r}; there are {', '.join(self.sections)}")
        sections = {**self.sections, region: Section(layers)}
        present = {layer.name for section in sections.values() for layer in section.layers}
        kept = {name: law for name, law in self.laws.items() if name in present}
        return Tissue(sections, {**kept, **laws})
