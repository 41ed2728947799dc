"""The page of an analysis."""

from deepkoco.analysis.page.page import Page, PageExistsError, check_free, data_folder, write_page

__all__ = ["Page", "PageExistsError", "check_free", "data_folder", "write_page"]
