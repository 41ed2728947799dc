"""Read log files into tables of columns, with one reader per format."""

from deepkoco.logs.formats.log_file import LogFile, Table
from deepkoco.logs.formats.open_log import FORMATS, open_log

__all__ = ["FORMATS", "LogFile", "Table", "open_log"]
