"""Measurements against named peers; each prints a table and can write JSON."""

from nufleet.shared.command_line import spare_processor_time

spare_processor_time()  # as every command of ours does, before NumPy is imported
