"""The documentation site: ``make docs`` writes it to build/site."""

import omad

project = "OMAD"
author = "The OMAD developers"
copyright = author
release = omad.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc"]
nb_execution_mode = "off"  # they are executed in the tests
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_default_options = {"members": True, "special-members": "__call__"}
autodoc_preserve_defaults = True
html_theme = "furo"
html_title = "OMAD"
html_theme_options = {"source_repository": ""}
