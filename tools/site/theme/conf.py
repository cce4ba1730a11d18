"""Settings of Sphinx for the site; `python -m tools.site` stages them beside the pages."""

import os

from tools.site.api import MOCKED

project = "angler_mjx"
copyright = "the angler_mjx contributors"
version = release = os.environ["ANGLER_SITE_VERSION"]
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_design",
    "sphinx_copybutton",
    "tools.site.docstrings",
    "tools.site.tables",
]
exclude_patterns = ["examples/**", "extra/**", "files/**"]
templates_path = ["_templates"]
root_doc = "index"

myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 6
# Names in single backticks of docstrings lead to their entries where these are on the site.
default_role = "py:obj"
suppress_warnings = ["myst.header"]

autodoc_mock_imports = MOCKED
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_preprocess_types = False
toc_object_entries_show_parents = "hide"
smartquotes_action = "D"  # no curly quotes: defaults in tables are code

html_theme = "pydata_sphinx_theme"
html_title = "angler_mjx"
html_extra_path = ["extra"]
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = [
    ("../../versions.js", {"defer": "defer"}),
    ("versions_menu.js", {"defer": "defer"}),
    ("figures.js", {"defer": "defer"}),
]
html_copy_source = False
html_show_sourcelink = False
html_favicon = "_static/mark.svg"
html_sidebars = {
    "index": [],
    "gallery": [],
    "examples": [],
    "all_pages": [],
}
html_context = {"default_mode": "auto"}  # light or dark, as the reader's system
html_theme_options = {
    "logo": {
        "text": "angler_mjx",
        "alt_text": "angler_mjx",
        "image_light": "_static/mark.svg",
        "image_dark": "_static/mark.svg",
    },
    "navbar_align": "left",
    "navbar_end": ["versions.html", "theme-switcher"],
    "header_links_before_dropdown": 8,
    "show_prev_next": True,
    "show_nav_level": 1,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": ["build.html"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
