"""Files that logs are stored in, one reader per format, all giving tables of columns."""

from deepkoco.logs.formats.log_file import LogFile, Table
from deepkoco.logs.formats.open_log import FORMATS, open_log

__all__ = ["FORMATS", "LogFile", "Table", "open_log"]
