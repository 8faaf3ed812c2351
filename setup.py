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
            'agent = kbnitp_ros.starting:agent',
            'demo = kbnitp_ros.starting:demo',
            'estimator = kbnitp_ros.starting:estimator',
            'planner = kbnitp_ros.starting:planner',
            'recorder = kbnitp_ros.starting:recorder',
            'replay = kbnitp_ros.starting:replay',
            'report = kbnitp_ros.starting:report',
            'robot = kbnitp_ros.starting:robot',
            'study = kbnitp_ros.starting:study',
        ],
    },
)
