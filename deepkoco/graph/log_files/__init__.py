"""Files that logs are stored in, one reader per format, all giving tables of columns."""

from deepkoco.graph.log_files.log_file import LogFile, Table
from deepkoco.graph.log_files.open_log import FORMATS, open_log

__all__ = ["FORMATS", "LogFile", "Table", "open_log"]
