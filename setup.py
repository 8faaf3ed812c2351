# SPDX-License-Identifier: Apache-2.0
"""Set up the ament_python package kbnitp_ros."""

from glob import glob
import os
from pathlib import Path
import sys

from setuptools import find_packages, setup

package_name = 'kbnitp_ros'

# What colcon installs into lib/kbnitp_ros, where `ros2 run` looks. pip would put these names into
# bin/, so a wheel has the command kbnitp alone.
executables = [
    'agent',
    'demo',
    'estimator',
    'forecast',
    'layout',
    'planner',
    'preflight',
    'recorder',
    'replay',
    'report',
    'robot',
    'study',
    'watch',
]
if {'bdist_wheel', 'dist_info', 'editable_wheel'} & set(sys.argv):
    executables = []

# colcon installs so, and does not look for another package in the folder of this one.
prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
is_built_by_colcon = bool({'develop', 'install'} & set(sys.argv))
if is_built_by_colcon and not any(Path(p, 'share/kbnitp_msgs').exists() for p in prefixes):
    here = Path(__file__).resolve().parent
    print(
        f'{package_name}: no node can start without the package kbnitp_msgs. Link it beside this '
        f'one, where colcon finds it, and build again: '
        f'ln -s {here}/msg_defs {here.parent}/kbnitp_msgs',
        file=sys.stderr,
    )

shown = ['matplotlib', 'pillow', 'tqdm']
studies = ['jinja2', 'joblib', 'pandas', 'threadpoolctl']
pages = ['furo', 'myst-nb', 'myst-parser', 'numpydoc', 'sphinx', 'sphinx-mathjax-offline']
logs = ['lz4', 'mcap', 'mcap-ros2-support', 'pyproj', 'zstandard']

setup(
    name=package_name,
    version='1.0.0',
    packages=find_packages(include=[package_name, f'{package_name}.*']),
    package_data={package_name: ['py.typed', 'report/assets/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        (f'share/{package_name}/launch', glob('launch/*.launch.py')),
        *(
            (f'share/{package_name}/{folder}', glob(f'{folder}/*.*'))
            for folder in ['config', *glob('config/*/')]
        ),
    ],
    python_requires='>=3.10',
    install_requires=['numba', 'numpy', 'PyYAML'],
    extras_require={
        # By this colcon knows what runs the tests.
        'test': ['pytest'],
        'study': [*shown, *studies],
        'report': [*shown, *logs],
        'environments': ['gymnasium>=1.1'],
        'docs': [*pages, *shown, *studies, *logs],
        'all': [*shown, *studies, *logs],
    },
    zip_safe=False,
    maintainer='kbnitp_ros maintainers',
    maintainer_email='maintainers@example.org',
    description='Informative path planning from robots that do not all come back.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'kbnitp = kbnitp_ros.__main__:main',
            *(f'{name} = kbnitp_ros.starting:{name}' for name in executables),
        ],
        'gymnasium.envs': ['__root__ = kbnitp_ros.environments:register_environments'],
    },
)
