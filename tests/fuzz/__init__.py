"""Spoilt files: what is done to valid ones, the process that opens them, and all that ever broke. Campaigns: tools.fuzz."""
