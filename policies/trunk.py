"""A small convolutional trunk that LeRobot's diffusion policy takes in place of a ResNet.

LeRobot looks a backbone up by name among torchvision's models, takes all of its children but the last two, and swaps
batch norm for group norm. Importing this module adds one whose name says that it is small; a checkpoint that names it
opens in stock LeRobot once this module has been imported. ResNet-18 on a CPU trains 30 times slower, and its stride of
32 leaves a keypoint layer two pixels to look at.
"""

from __future__ import annotations

import torchvision
from torch import Tensor, nn

NAME = "resnet_resync_small"
SHARPNESS = 6.0
"""Factor on the features. LeRobot's spatial softmax has no temperature: on features of size one it begins as an average
over the whole picture, and learns to point at things only slowly."""


class _Residual(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.norm1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(outputs)
        self.skip = nn.Conv2d(inputs, outputs, 1, stride, bias=False)
        self.relu = nn.ReLU()

    def forward(self, x: Tensor) -> Tensor:
        y = self.norm2(self.conv2(self.relu(self.norm1(self.conv1(x)))))
        return self.relu(y + self.skip(x))


class _Sharpen(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return SHARPNESS * x


class SmallResNet(nn.Module):
    """Stride 8: from (3, h, w) to (96, h / 8, w / 8), then the pooling and classifying layers that LeRobot drops."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = nn.Sequential(nn.Conv2d(3, 32, 5, 2, 2, bias=False), nn.BatchNorm2d(32), nn.ReLU())
        self.layer1 = _Residual(32, 32, 2)
        self.layer2 = _Residual(32, 64, 2)
        self.layer3 = nn.Sequential(nn.Conv2d(64, 96, 3, 1, 1, bias=False), nn.BatchNorm2d(96), nn.ReLU(), _Sharpen())
        self.avgpool = nn.AdaptiveAvgPool2d(1)
        self.fc = nn.Linear(96, 1)

    def forward(self, x: Tensor) -> Tensor:
        x = self.layer3(self.layer2(self.layer1(self.stem(x))))
        return self.fc(self.avgpool(x).flatten(1))


def _make(weights: None = None) -> SmallResNet:
    """As torchvision's makers are called; there are no pretrained weights."""
    return SmallResNet()


setattr(torchvision.models, NAME, _make)
