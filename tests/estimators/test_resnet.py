"""The residual trunk is the published one, by its names and numbers, and reads weights by those names."""

import sys
from types import SimpleNamespace

import numpy as np
import onnxruntime
import pytest
from tests.refusals import refused

from palpate.core.errors import InputError, MissingExtraError

torch = pytest.importorskip("torch", reason="the extra `train` is not installed")

from palpate.estimators.networks.resnet import ResNet18, read_weights  # noqa: E402
from palpate.estimators.networks.torch_export import TorchGraph  # noqa: E402


def normalisation(name: str) -> set[str]:
    kept = ("weight", "bias", "running_mean", "running_var", "num_batches_tracked")
    return {f"{name}.{part}" for part in kept}


def published_names() -> set[str]:
    """By torchvision's rule: four layers of two blocks, shortcuts with weights in the last three."""
    names = {"conv1.weight"} | normalisation("bn1")
    for layer in (1, 2, 3, 4):
        for block in (0, 1):
            for i in (1, 2):
                at = f"layer{layer}.{block}"
                names |= {f"{at}.conv{i}.weight"} | normalisation(f"{at}.bn{i}")
        if layer > 1:
            names |= {f"layer{layer}.0.downsample.0.weight"} | normalisation(f"layer{layer}.0.downsample.1")
    return names


@pytest.fixture(scope="module")
def trained() -> dict[str, "torch.Tensor"]:
    """As if trained: running means and spreads are not those of the beginning; with a last layer."""
    torch.manual_seed(4)
    state = ResNet18(3).state_dict()
    moved = {k: v + 0.1 * torch.rand(v.shape) if v.is_floating_point() else v for k, v in state.items()}
    return moved | {"fc.weight": torch.zeros(1000, 512), "fc.bias": torch.zeros(1000)}


@pytest.fixture
def weights(trained) -> dict[str, "torch.Tensor"]:
    return dict(trained)


def features(trunk: ResNet18, image: "torch.Tensor") -> np.ndarray:
    with torch.no_grad():
        return trunk.eval()(image).numpy()


def test_its_parts_carry_the_published_names() -> None:
    assert set(ResNet18(3).state_dict()) == published_names()
    assert sum(p.numel() for p in ResNet18(3).parameters()) == 11_176_512


def test_as_onnx_it_gives_the_same_features(weights) -> None:
    channels = 3
    trunk = ResNet18(channels)
    trunk.take(weights, "weights")
    graph = TorchGraph()
    graph.add("Identity", [graph.add_layer(trunk.eval(), "image")], {}, output="value")
    # An odd size: a pooling or a padding half a pixel off would show.
    image = torch.randn(3, channels, 45, 37)
    model = graph.model((channels, 45, 37), 512).SerializeToString()
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    (exported,) = session.run(["value"], {"image": image.numpy()})
    wanted = features(trunk, image)
    # float32 through 18 layers in another order of summation.
    assert np.max(np.abs(exported - wanted)) < 1e-5 * np.ptp(wanted)


def test_a_grey_trunk_answers_as_the_coloured_one_to_a_grey_image(weights) -> None:
    coloured, grey = ResNet18(3), ResNet18(1)
    coloured.take(weights, "weights")
    grey.take(weights, "weights")
    image = torch.randn(2, 1, 32, 32)
    wanted = features(coloured, image.expand(-1, 3, -1, -1))
    np.testing.assert_allclose(features(grey, image), wanted, atol=1e-5 * np.ptp(wanted))


def test_weights_of_other_names_or_shapes_are_refused(weights) -> None:
    trunk = ResNet18(3)
    with refused("weights-shape", InputError):
        trunk.take(weights | {"bn1.bias": torch.zeros(32)}, "weights")
    del weights["layer2.0.downsample.0.weight"]
    with refused("weights-names", InputError):
        trunk.take(weights | {"stem": torch.zeros(1)}, "weights")


def test_files_that_may_run_code_and_missing_ones_are_refused(tmp_path) -> None:
    for name in ("resnet18.pth", "resnet18.npz", "resnet18"):
        (tmp_path / name).write_bytes(b"")
        with refused("weights-kind", InputError):
            read_weights(tmp_path / name)
    with refused("file-missing", InputError):
        read_weights(tmp_path / "resnet18.safetensors")


def test_a_missing_package_is_named_with_its_remedy(tmp_path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "safetensors.torch", None)
    (tmp_path / "resnet18.safetensors").write_bytes(b"")
    with pytest.raises(MissingExtraError, match=r"palpate\[train\]"):
        read_weights(tmp_path / "resnet18.safetensors")


def test_what_the_package_cannot_read_is_refused(tmp_path, monkeypatch) -> None:
    def fail(path: object) -> None:
        raise RuntimeError("header too large")

    monkeypatch.setitem(sys.modules, "safetensors", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "safetensors.torch", SimpleNamespace(load_file=fail))
    (tmp_path / "resnet18.safetensors").write_bytes(b"")
    with refused("weights-unreadable", InputError):
        ResNet18(3).load_weights(tmp_path / "resnet18.safetensors")


def test_weights_are_read_from_the_published_format(tmp_path, weights) -> None:
    torch_files = pytest.importorskip("safetensors.torch", reason="safetensors is not installed")
    path = tmp_path / "resnet18.safetensors"
    torch_files.save_file({k: v.contiguous() for k, v in weights.items()}, path)
    trunk = ResNet18(3)
    trunk.load_weights(path)
    for name, value in trunk.state_dict().items():
        assert torch.equal(value, weights[name])
