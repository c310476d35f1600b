"""Which stages of a registration measure positions anew, by names that the whole package shares."""

from __future__ import annotations

#: Their rows are appended to the tie points of the matcher: True in no other stage, and no filter's choice.
MEASURED = ("locate", "refine")
