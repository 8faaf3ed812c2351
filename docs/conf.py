# SPDX-License-Identifier: Apache-2.0
"""How Sphinx builds these pages: Markdown and notebooks by MyST, the API from docstrings."""

from pathlib import Path
import xml.etree.ElementTree as ElementTree

package = ElementTree.parse(Path(__file__).parent.parent / 'package.xml')

project = 'kbnitp_ros'
copyright = '2026, kbnitp_ros maintainers'
author = 'kbnitp_ros maintainers'
version = release = package.findtext('version')

extensions = [
    'myst_nb',
    'numpydoc',
    'sphinx.ext.autodoc',
    'sphinx.ext.autosummary',
    'sphinx.ext.mathjax',
    'sphinx.ext.viewcode',
    'sphinx-mathjax-offline',
]
source_suffix = {'.md': 'myst-nb', '.ipynb': 'myst-nb'}
exclude_patterns = ['_build', '_templates']
templates_path = ['_templates']
html_static_path = ['_static']
html_css_files = ['site.css']
html_js_files = ['site.js']

autodoc_default_options = {'members': True, 'show-inheritance': True}
autodoc_member_order = 'bysource'
numpydoc_show_class_members = False
# A page for each public name, which search and other projects find.
autosummary_generate = True
# As they stand in the code, which is short.
autodoc_preserve_defaults = True
autodoc_type_aliases = {'ArrayLike': 'ArrayLike', 'NDArray': 'NDArray'}

myst_enable_extensions = ['colon_fence', 'dollarmath']
myst_heading_anchors = 4
# They are shown as they stand there; a test holds them to what comes out.
nb_execution_mode = 'off'

html_theme = 'furo'
html_title = f'kbnitp_ros {release}'
