"""A comparison as one self-contained HTML page.

A `Study` becomes plain data (`from_study`, `data`), that the JSON of the page (`content`), and that one file (`page`).
"""

from featreg.report.data import ReportColumn, ReportEntry, ReportPair, ReportStudy, ReportSweep, ReportTable
from featreg.report.page import write_report

__all__ = ["ReportColumn", "ReportEntry", "ReportPair", "ReportStudy", "ReportSweep", "ReportTable", "write_report"]
