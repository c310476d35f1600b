"""Options that several commands share: how images are read, which pixels are data, what is said of a method."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

import typer

from featreg.cli import completion
from featreg.cli.checking import number, whole_number

NodataOption: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--nodata",
        parser=number,
        metavar="VALUE",
        help="Value of pixels without data.",
        show_default="what the file says",
    ),
]


BandOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--band",
        metavar="BAND",
        help="Which band of a file of several: its name (VV), its number, iq for complex samples of two, rgb.",
        show_default="the only one",
    ),
]


CalibrateOption: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--calibrate",
        metavar="QUANTITY",
        help="Read samples of a product as amplitudes of sigma0, beta0 or gamma0, by its own metadata.",
        show_default="as they are",
        autocompletion=completion.words("sigma0", "beta0", "gamma0"),
    ),
]


@dataclass(frozen=True)
class ReadingOptions:
    """How the two images of a pair are read."""

    scale: Annotated[
        str | None,
        typer.Option(
            "--scale",
            metavar="SCALE",
            help="What the samples are: amplitude, intensity or db.",
            show_default="told from the samples",
            autocompletion=completion.scales,
        ),
    ] = None
    calibrate: CalibrateOption = None
    nodata: NodataOption = None
    band: BandOption = None
    reference_band: Annotated[
        str | None,
        typer.Option("--reference-band", metavar="BAND", help="That of the reference.", show_default="--band"),
    ] = None
    secondary_band: Annotated[
        str | None,
        typer.Option("--secondary-band", metavar="BAND", help="That of the secondary.", show_default="--band"),
    ] = None

    def reading(self) -> dict[str, Any]:
        """As keywords."""
        return {field.name: getattr(self, field.name) for field in dataclasses.fields(ReadingOptions)}


@dataclass(frozen=True)
class MaskOptions:
    """Which pixels of a pair are data."""

    mask_reference: Annotated[
        str | None,
        typer.Option(
            "--mask-reference", metavar="FILE", help="Image of the same size, 0 = no data.", show_default=False
        ),
    ] = None
    mask_secondary: Annotated[
        str | None,
        typer.Option(
            "--mask-secondary", metavar="FILE", help="Image of the same size, 0 = no data.", show_default=False
        ),
    ] = None

    def keywords(self) -> dict[str, Any]:
        """As keywords."""
        return {"reference_mask": self.mask_reference, "secondary_mask": self.mask_secondary}


@dataclass(frozen=True)
class MethodOptions(ReadingOptions):
    """What `match`, `compare`, `sweep` and `stack` all say of a method and of how images are read."""

    model: Annotated[
        str | None,
        typer.Option(
            "--model",
            metavar="NAME",
            help="Geometric model: translation, rigid, similarity, affine, homography, polynomial2, polynomial3, "
            "residual-field or, for scenes with RPCs, rpc-bias.",
            show_default="affine",
            autocompletion=completion.models,
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Replace a part (detector=fast, filters=gms,fsc) or a parameter (fsc.threshold=2) of the method; may "
            "be repeated. `featreg list` names them all.",
            show_default=False,
            autocompletion=completion.settings,
        ),
    ] = None
    seed: Annotated[
        int,
        typer.Option(
            "--seed", parser=whole_number(0), metavar="N", help="Of everything random; equal seeds give equal results."
        ),
    ] = 0
    n_features: Annotated[
        int | None,
        typer.Option(
            "--n-features",
            parser=whole_number(1),
            metavar="N",
            help="Most features per image and most tie points; in blocks, of each block.",
            show_default="5000, in blocks 1000",
        ),
    ] = None
    locate: Annotated[
        bool | None,
        typer.Option(
            "--locate/--no-locate",
            help="Measure the positions of the matches again after the first model.",
            show_default="as the method has it",
        ),
    ] = None
    refine: Annotated[
        bool | None,
        typer.Option(
            "--refine/--no-refine",
            help="Sub-pixel tie points around the first model.",
            show_default="as the method has it",
        ),
    ] = None

    def keywords(self) -> dict[str, Any]:
        """Those that are keywords of `featreg.match` and of a protocol alike."""
        return {name: getattr(self, name) for name in ("model", "n_features", "locate", "refine")} | self.reading()
