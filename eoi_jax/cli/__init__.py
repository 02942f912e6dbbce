"""The command line: configs, folders of runs, summaries, the page."""
