# SPDX-License-Identifier: Apache-2.0
"""Set up the ament_python package kbnitp_ros."""

from glob import glob

from setuptools import find_packages, setup

package_name = 'kbnitp_ros'

setup(
    name=package_name,
    version='0.2.0',
    packages=find_packages(include=[package_name, f'{package_name}.*']),
    package_data={package_name: ['py.typed', 'report/assets/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{package_name}']),
        (f'share/{package_name}', ['package.xml']),
        (f'share/{package_name}/config', glob('config/*')),
        (f'share/{package_name}/foxglove', glob('foxglove/*.json')),
        (f'share/{package_name}/launch', glob('launch/*.launch.py')),
        (f'share/{package_name}/rviz', glob('rviz/*.rviz')),
        (f'share/{package_name}/security', glob('security/*.policy.xml')),
        (f'share/{package_name}/scenarios', glob('scenarios/*.yaml')),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='kbnitp_ros maintainers',
    maintainer_email='maintainers@example.org',
    description='Informative path planning from robots that do not all come back.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'agent = kbnitp_ros.nodes.agent:main',
            'demo = kbnitp_ros.cli.demo:main',
            'estimator = kbnitp_ros.nodes.estimator:main',
            'planner = kbnitp_ros.nodes.planner:main',
            'recorder = kbnitp_ros.nodes.recorder:main',
            'replay = kbnitp_ros.cli.replay:main',
            'report = kbnitp_ros.cli.report:main',
            'robot = kbnitp_ros.nodes.robot:main',
            'study = kbnitp_ros.cli.study:main',
            'team = kbnitp_ros.nodes.team:main',
        ],
    },
)
