"""What the instruments of the world are: one frozen model each, every number with its unit in its name."""

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

# Wide enough for every rig, narrow enough that no arithmetic with such numbers overflows.
Positive = Annotated[float, Field(ge=1e-6, le=1e9)]
NonNegative = Annotated[float, Field(ge=0, le=1e9)]
Signed = Annotated[float, Field(ge=-1e6, le=1e6)]
PositiveLength = Annotated[float, Field(ge=1e-6, le=1e6)]
NonNegativeLength = Annotated[float, Field(ge=0, le=1e6)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Degrees = Annotated[float, Field(ge=-180, le=180)]
SmallTilt = Annotated[float, Field(gt=-45, lt=45)]
Pixels = Annotated[int, Field(ge=16, le=8192)]
Vector2 = tuple[Signed, Signed]
Vector3 = tuple[Signed, Signed, Signed]
Brown = tuple[Signed, Signed, Signed, Signed, Signed]


class Part(BaseModel):
    """A part of the world: immutable, unknown keys refused, no silent conversions, no NaN or infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


def _check_axis(axis: Vector3) -> None:
    length = math.hypot(*axis)
    if length < 1e-6:
        raise ValueError("the axis has no direction: give a vector that is not zero")
    if abs(axis[0]) / length > 0.999999:
        raise ValueError("the axis is parallel to x, so that a roll of 0 is undefined")


class Camera(Part):
    """Pinhole with Brown distortion (k1, k2, p1, p2, k3: OpenCV's order) and a sensor; rides on stage1.

    `psf_px` is the rms width of a Gaussian that holds lens blur and pixel aperture together. `gain` 1 puts
    the full well at full scale. A `gamma` g turns a linear share x of full scale into x^(1/g).
    """

    position_mm: Vector3
    axis: Vector3
    roll_deg: Degrees
    size_px: tuple[Pixels, Pixels]
    pixel_um: Positive
    fc_px: tuple[Positive, Positive]
    cc_px: Vector2
    kc: Brown
    f_number: Positive
    psf_px: Annotated[float, Field(ge=0, le=8)]
    exposure_us: Positive
    bits: Literal[8, 10]
    gain: Positive
    gamma: Annotated[float, Field(ge=0.1, le=10)]
    full_well_e: Positive
    read_noise_e: NonNegative
    shot_noise: bool

    @model_validator(mode="after")
    def _possible(self) -> "Camera":
        _check_axis(self.axis)
        return self


class Projector(Part):
    """A camera run backwards, fixed in the world; columns grow with +x at roll 0.

    `tilt_about_x_deg` and `tilt_about_y_deg` turn it, lens and frame, about the point `tilt_pivot_mm` in front
    of the lens on its nominal axis: right-handed, first about the world's x axis through that pivot, then about
    the world's y axis through it. So with `axis` (0, 0, -1) a positive `tilt_about_y_deg` moves the lens, which
    is above the pivot, toward +x and turns the forward axis toward -x; a positive `tilt_about_x_deg` moves the
    lens toward -y and turns the forward axis toward +y.

    `distortion` is Brown's model (k1, k2, p1, p2, k3); `warp_*` add a smooth displacement of that amplitude and
    period that no Brown model describes. The image's words are rounded to `bits`, then shown as light
    `black_level + (1 - black_level) word^gamma`, blurred by the lens (`lens_blur_px`, rms, in projector pixels).
    """

    position_mm: Vector3
    axis: Vector3
    roll_deg: Degrees
    mirrored: bool
    tilt_about_x_deg: SmallTilt
    tilt_about_y_deg: SmallTilt
    tilt_pivot_mm: NonNegativeLength
    size_px: tuple[Pixels, Pixels]
    pixel_um: Positive
    focal_mm: PositiveLength
    distortion: Brown
    warp_amplitude_px: NonNegative
    warp_period_px: Positive
    radiant_intensity_mw_per_sr: Positive
    black_level: Fraction
    gamma: Annotated[float, Field(ge=0.1, le=10)]
    bits: Annotated[int, Field(ge=1, le=8)]
    lens_blur_px: Annotated[float, Field(ge=0, le=8)]

    @model_validator(mode="after")
    def _possible(self) -> "Projector":
        _check_axis(self.axis)
        return self


class Light(Part):
    """One wavelength band: all in which infrared and visible light differ.

    Ambient light reaches every pixel alike; from frame to frame it varies by `ambient_flicker` (rms share).
    """

    wavelength_nm: Positive
    filter_transmission: Annotated[float, Field(gt=0, le=1)]
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)]
    ambient_radiance_uw_per_mm2_sr: NonNegative
    ambient_flicker: Fraction


class Lights(Part):
    """The two light sources that the rig can be run with."""

    infrared: Light
    visible: Light


class Lamp(Part):
    """Flood light on diffuse surfaces, for the checkerboard."""

    irradiance_uw_per_mm2: NonNegative


class Glass(Part):
    """Thin ground glass, fixed in the world: a Lambertian screen seen from either side.

    The tilts turn it about its centre. `bow_um` is the height of its paraboloid at the middles of its edges
    above its centre, away from the mirror. `transmission` is the share of the projector's light that it
    scatters toward the mirror, `backscatter` the share toward the projector's side (its direct view).
    """

    centre_mm: Vector3
    size_mm: tuple[PositiveLength, PositiveLength]
    tilt_about_x_deg: SmallTilt
    tilt_about_y_deg: SmallTilt
    bow_um: Signed
    transmission: Fraction
    backscatter: Fraction


class Stage1(Part):
    """Carries camera, mirror and objects; positive, (0, 0, -1) before the tilts, is away from the glass.

    `backlash_um` is the play of its drive as its controller meets it.
    """

    axis_tilt_about_x_deg: SmallTilt
    axis_tilt_about_y_deg: SmallTilt
    travel_mm: Vector2
    position_noise_um: NonNegative
    backlash_um: NonNegative = 0.0
    scale_error_ppm: Annotated[float, Field(ge=-1e5, le=1e5)]

    @model_validator(mode="after")
    def _possible(self) -> "Stage1":
        if not self.travel_mm[0] <= 0 <= self.travel_mm[1]:
            raise ValueError("travel_mm must be [lowest, highest] with 0 between them")
        return self


class Stage2(Part):
    """Carries the white plate along the camera's optical axis (as that is at stage1 = 0); fixed in the world.

    At position 0 the plate is `start_mm` in front of the camera. Tilts are about the camera's x and y axes:
    those of the axis turn the direction of travel, those of the plate its surface.
    """

    start_mm: PositiveLength
    travel_mm: PositiveLength
    axis_tilt_about_x_deg: SmallTilt
    axis_tilt_about_y_deg: SmallTilt
    plate_tilt_about_x_deg: SmallTilt
    plate_tilt_about_y_deg: SmallTilt
    position_noise_um: NonNegative
    backlash_um: NonNegative = 0.0


class Mirror(Part):
    """Plane mirror, z = 0 of frame M; the part `sprayed_x_mm` of it (null: none) is sprayed and diffuse."""

    x_mm: Vector2
    y_mm: Vector2
    sprayed_x_mm: Vector2 | None
    reflectivity: Fraction
    sprayed_albedo: Fraction

    @model_validator(mode="after")
    def _possible(self) -> "Mirror":
        for name, (low, high) in (("x_mm", self.x_mm), ("y_mm", self.y_mm)):
            if not low < high:
                raise ValueError(f"{name} must be [low, high] with low < high")
        if self.sprayed_x_mm is not None:
            low, high = self.sprayed_x_mm
            inside = self.x_mm[0] <= low < high <= self.x_mm[1]
            if not inside or (low == self.x_mm[0]) == (high == self.x_mm[1]):
                raise ValueError("sprayed_x_mm must be a part of x_mm that reaches one of its two ends")
        return self


class Plate(Part):
    """White plate on stage2, centred on its axis."""

    size_mm: tuple[PositiveLength, PositiveLength]
    albedo: Fraction


class Board(Part):
    """Checkerboard: `squares` along its x and y; the square at its (-x, -y) corner is black.

    The `poses` free poses are drawn from the world's seed: distance along the camera's axis, tilt against the
    image plane, turn in it; the whole chequered part keeps `margin_px` from the image's edge. `on_plate_*`
    places it on the plate, its plane being the plate's surface.
    """

    squares: tuple[Annotated[int, Field(ge=3, le=100)], Annotated[int, Field(ge=3, le=100)]]
    square_mm: PositiveLength
    border_mm: NonNegativeLength
    white_albedo: Fraction
    black_albedo: Fraction
    poses: Annotated[int, Field(ge=1, le=1000)]
    distance_mm: tuple[PositiveLength, PositiveLength]
    tilt_deg: tuple[Annotated[float, Field(ge=0, lt=80)], Annotated[float, Field(ge=0, lt=80)]]
    turn_deg: tuple[Degrees, Degrees]
    margin_px: NonNegative
    on_plate_centre_mm: Vector2
    on_plate_turn_deg: Degrees

    @model_validator(mode="after")
    def _possible(self) -> "Board":
        for name in ("distance_mm", "tilt_deg", "turn_deg"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} must be [low, high] with low <= high")
        if self.black_albedo >= self.white_albedo:
            raise ValueError("black_albedo must be below white_albedo")
        return self
