"""Placeholder."""
def write_tables(folder): return ""
