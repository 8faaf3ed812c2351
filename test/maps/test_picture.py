# SPDX-License-Identifier: Apache-2.0
"""The image of a map as a page shows it."""

from base64 import b64decode
from io import BytesIO

from kbnitp_ros.maps import read_site
from kbnitp_ros.maps.files import MOST_SHOWN
import numpy as np
from PIL import Image
import pytest

YAML = """
image: map.png
resolution: 0.05
origin: [3.0, -4.0, 0.3]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


def shown(folder, pixels):
    Image.fromarray(pixels).save(folder / 'map.png')
    (folder / 'map.yaml').write_text(YAML)
    site = read_site(folder / 'map.yaml')
    content = b64decode(site.source.removeprefix('data:image/png;base64,'))
    return site, np.asarray(Image.open(BytesIO(content)))


def test_a_site_has_the_rows_of_its_image_and_its_transparency(tmp_path):
    pixels = np.array([[[9, 255], [99, 255], [199, 0]], [[1, 255], [2, 255], [3, 255]]], np.uint8)
    site, picture = shown(tmp_path, pixels)
    assert picture.tolist() == pixels.tolist()
    assert (site.width, site.height) == pytest.approx((0.15, 0.1))
    assert (site.origin, site.yaw) == ((3.0, -4.0), 0.3)


def test_a_large_image_is_made_smaller(tmp_path):
    site, picture = shown(tmp_path, np.full((1500, 3000), 254, np.uint8))
    assert picture.shape[:2] == (MOST_SHOWN // 2, MOST_SHOWN)
    assert (site.width, site.height) == pytest.approx((150.0, 75.0))
