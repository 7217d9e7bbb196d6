"""The tables and figures of the source documents, each by one command.

``python -m tests.studies NAME`` makes the runs that are not there yet, then writes a CSV with every
run, a Markdown table with the reported value beside ours, and a plot.
"""
