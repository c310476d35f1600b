"""OpenCV, kornia and torch: their algorithms, keypoints and tensors."""
