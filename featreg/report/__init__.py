"""A comparison as one self-contained HTML page."""

from featreg.report.page import write_report
from featreg.report.study import ReportColumn, ReportEntry, ReportPair, ReportStudy, ReportSweep, ReportTable

__all__ = ["ReportColumn", "ReportEntry", "ReportPair", "ReportStudy", "ReportSweep", "ReportTable", "write_report"]
