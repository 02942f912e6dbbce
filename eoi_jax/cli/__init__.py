"""The command line: commands and their actions, configs, folders of runs, summaries, the page.

Modules are imported at their first use (`lazy_loader`); the stub beside this file names them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
