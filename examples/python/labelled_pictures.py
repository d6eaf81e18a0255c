"""A thousand labelled pictures of a forest, as arrays: for training, without a file in between.

    python3 labelled_pictures.py --samples 1000
"""
import argparse
import time

import numpy
import rigor

parser = argparse.ArgumentParser()
parser.add_argument("--samples", type=int, default=1000)
parser.add_argument("--rig", default="stereo-forest")
parser.add_argument("--channel", default="left")
options = parser.parse_args()

dataset = rigor.dataset(options.rig, channels=[options.channel], within=(-40, -40, 40, 40), height=(1, 2), pitch=(-5, 10),
                        samples=options.samples, seed=7)
names = {category["id"]: category["name"] for category in dataset.categories}
begin, pictures, things, pixels = time.monotonic(), 0, 0, numpy.zeros(256, int)
for sample in dataset:
    view = sample[options.channel]
    pictures, things = pictures + 1, things + len(view.instances)
    pixels += numpy.bincount(view.category.ravel(), minlength=256)
seconds = time.monotonic() - begin
print(f"{pictures} pictures {view.array.shape}, {things} boxes in {seconds:.0f} s: {60 * pictures / seconds:.0f} a minute")
for category in numpy.flatnonzero(pixels[1:]) + 1:
    print(f"{names[category]:12} {pixels[category] / pixels.sum():6.1%} of all pixels")
