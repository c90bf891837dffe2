"""View stores, rendered or cropped from photographs and videos, and the pairs that are sampled from them."""
