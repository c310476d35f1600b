"""The figures of the three papers on one page: SAR-ORB's 3 and 5, OBCLS's 2 to 7, PMEA's 3 to 18.

    python benchmarks/draw_figures.py [--out figures.html] [--couples 90] [--seed 0] [--scenes DIR] [--png DIR]
                                      [--only matching,targets,focusing]

Real images come from the folder that FEATREG_DATA names, simulated ones stand in where there are none; every caption
says what is shown and how it compares with the paper's. With --png DIR each figure is a file too.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from figures import focusing, matching, targets
from figures.page import Figure, write_page
from measuring import machine, on_one_thread

#: What stands at the head of the page.
WHOSE = "The numbers in the captions, and the orders that stand beside the paper's, are those of this run."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("figures.html"))
    parser.add_argument("--png", type=Path, help="folder for the pictures")
    parser.add_argument("--couples", type=int, default=90, help="simulated ones of OBCLS's Figures 5 to 7, at most 90")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--scenes", type=Path, help="folder in which simulated scenes are kept")
    parser.add_argument("--only", default="matching,targets,focusing")
    given = parser.parse_args()
    wanted = given.only.split(",")
    with ExitStack() as stack:
        folder = given.scenes or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        makers: dict[str, tuple[str, str, Callable[[], list[Figure]]]] = {
            "matching": (matching.PAPER, matching.SAID, lambda: matching.figures(folder, given.seed)),
            "targets": (targets.PAPER, targets.SAID, lambda: targets.figures(min(given.couples, 90), given.seed)),
            "focusing": (focusing.PAPER, focusing.SAID, lambda: focusing.figures(given.seed)),
        }
        unknown = [name for name in wanted if name not in makers]
        if unknown:
            raise SystemExit(f"unknown part '{unknown[0]}', known: {', '.join(makers)}")
        parts = [(paper, said, make()) for name, (paper, said, make) in makers.items() if name in wanted]
    run = f"Seed {given.seed}, {min(given.couples, 90)} couples; {machine()}."
    write_page(given.out, parts, f"{run} {WHOSE}")
    if given.png is not None:
        given.png.mkdir(parents=True, exist_ok=True)
        for name, (_, _, drawn) in zip((n for n in makers if n in wanted), parts, strict=True):
            for number, figure in enumerate(drawn, start=1):
                (given.png / f"{name}-{number}-{figure.number.lower().replace(' ', '-')}.png").write_bytes(figure.png)
    print(f"written: {given.out}, {sum(len(drawn) for _, _, drawn in parts)} figures")


if __name__ == "__main__":
    on_one_thread(pinned=False)
    main()
