"""Closed forms and Fourier series for the unit disc; they share no code with eitskin.

Conventions: radius 1, sheet conductance (sigma h) 1 S outside the inclusion and `factor` inside;
z = contact impedivity times conductivity over the radius. Electrode l sits at `angles[l]`, current
counts positive into the disc. On electrode l the current per arc length is (U_l - u) / z and
integrates to I_l; none flows between electrodes. A transfer impedance R (n, n) holds in [i, j] the
potential of electrode i for a unit current into j; only its differences over currents that sum to
0 mean anything. For points R[i, i] is infinite and stands as NaN.
"""

import numpy as np


def voltages(impedance, channels):
    """Voltages (M,) at unit current of channels (M, 4) source, sink, plus, minus."""
    source, sink, plus, minus = np.asarray(channels).T
    return (impedance[plus, source] - impedance[plus, sink]) - (
        impedance[minus, source] - impedance[minus, sink]
    )


def points_homogeneous(angles):
    """Neumann function of the unit disc between rim points: -log |e^ia - e^ib| / pi."""
    rim = np.exp(1j * np.asarray(angles))
    distance = abs(rim[:, None] - rim[None, :])
    np.fill_diagonal(distance, np.nan)
    return -np.log(distance) / np.pi


def points_concentric(angles, radius, factor):
    """A concentric disc of `radius` with conductivity `factor`: Fourier series on the rim.

    cos(m t) of current gives cos(m t) (1 - q) / (m (1 + q)), q = (factor - 1) / (factor + 1)
    radius^2m; the homogeneous part of it is summed in closed form.
    """
    angles = np.asarray(angles)
    m = np.arange(1, int(np.ceil(-20.0 / np.log(radius))) + 2)
    q = (factor - 1.0) / (factor + 1.0) * radius ** (2.0 * m)
    change = -2.0 * q / (1.0 + q) / m
    cosine, sine = np.cos(angles[:, None] * m), np.sin(angles[:, None] * m)
    series = (cosine * change) @ cosine.T + (sine * change) @ sine.T
    return points_homogeneous(angles) + series / np.pi


def points_concentric_by_images(angles, radius, factor, images=200):
    """The same by images: charges reflected again and again in the inclusion and in the rim.

    1 / (1 + q) as a geometric series: sum_k 2 (-p)^k / pi log |1 - a^2k e^it|.
    """
    angles = np.asarray(angles)
    p = (factor - 1.0) / (factor + 1.0)
    step = np.exp(1j * (angles[:, None] - angles[None, :]))
    total = points_homogeneous(angles)
    for k in range(1, images + 1):
        total = total - 2.0 * (-p) ** k / np.pi * np.log(abs(1.0 - radius ** (2.0 * k) * step))
    return total


def disc_map(centre, radius):
    """Moebius map of the unit disc onto itself that makes an eccentric disc concentric.

    centre: complex, |centre| + radius < 1. Returns (alpha, new radius): w = (z - alpha) /
    (1 - conj(alpha) z) takes the circle to the circle of the new radius round 0. alpha and
    1 / conj(alpha) mirror each other in the rim; they must do so in the circle as well.
    """
    distance = abs(centre)
    if distance == 0.0:
        return 0.0, radius
    sum_of_poles = (1.0 + distance**2 - radius**2) / distance
    alpha = 0.5 * (sum_of_poles - np.sqrt(sum_of_poles**2 - 4.0))
    near = distance + radius
    mapped = (near - alpha) / (1.0 - alpha * near)
    return alpha * centre / distance, mapped


def points_eccentric(angles, centre, radius, factor):
    """A disc of `radius` at complex `centre`: currents are conformally invariant, points move."""
    alpha, mapped = disc_map(centre, radius)
    rim = np.exp(1j * np.asarray(angles))
    return points_concentric(np.angle((rim - alpha) / (1.0 - np.conj(alpha) * rim)), mapped, factor)


def points_touching(angles, direction, radius, factor, gap=1e-4):
    """A disc that touches the rim from within, at the angle `direction`.

    The Moebius map has no image of it, but the voltages are smooth in the gap to the rim: a
    polynomial through gap, gap / 2 and gap / 4, taken at 0. Its error falls with the cube of `gap`.
    """
    one, half, quarter = (
        points_eccentric(angles, (1.0 - radius - g) * np.exp(1j * direction), radius, factor)
        for g in (gap, gap / 2.0, gap / 4.0)
    )
    return (one - 6.0 * half + 8.0 * quarter) / 3.0


def complete_series(n, width, z, inclusion=None, periods=400):
    """Complete electrodes: n of arc `width` at 2 pi l / n, Galerkin in Fourier series of the rim.

    inclusion: None or (radius, factor), concentric. With u = sum u_m e^imt the weak form reads
    2 pi |m| b_m u_m + sum_k T_mk u_k / z = (rim charge), b_m the inclusion's factor, T the Fourier
    matrix of the electrodes' indicator. Rotation by one electrode multiplies by a phase: each of
    the n phases is a system of its own, with frequencies s + n p, |p| <= periods.
    Error: the current jumps at the electrode edges, u_m ~ m^-2, R converges like periods^-2.
    """
    admittance = np.zeros(n)
    p = np.arange(-periods, periods + 1)
    for s in range(n):
        m = s + n * p
        order = abs(m).astype(float)
        rim = 2.0 * np.pi * order
        if inclusion is not None:
            radius, factor = inclusion
            q = (factor - 1.0) / (factor + 1.0) * radius ** (2.0 * order)
            rim = rim * (1.0 + q) / (1.0 - q)
        difference = (m[:, None] - m[None, :]) / 2.0
        electrodes = n * width * np.sinc(difference * width / np.pi)
        load = n * width * np.sinc(m / 2.0 * width / np.pi)
        potential = np.linalg.solve(np.diag(rim) + electrodes / z, load / z)
        # U_l = e^(2 pi i s l / n); the mean over electrodes of the current it draws
        admittance[s] = (width - load @ potential / n) / z
    resistance = np.zeros(n)
    resistance[1:] = 1.0 / admittance[1:]
    row = np.fft.ifft(resistance).real
    return row[(np.arange(n)[:, None] - np.arange(n)[None, :]) % n]


def complete_electrodes(n, width, z, inclusion=None, periods=150):
    """As `complete_series`, extrapolated over 1, 2 and 4 times `periods`.

    Returns the transfer impedance and an estimate of its largest error, from the last step.
    """
    series = [complete_series(n, width, z, inclusion, k * periods) for k in (1, 2, 4)]
    return extrapolated(*series)


def extrapolated(coarse, middle, fine):
    """Richardson with error ~ periods^-2: value and size of the last correction."""
    once = [(4.0 * b - a) / 3.0 for a, b in ((coarse, middle), (middle, fine))]
    return once[1], float(np.max(abs(once[1] - once[0])))


def complete_general(angles, widths, z, touch=None, harmonics=1000):
    """Complete electrodes anywhere, each with its width and z, and one circular touch anywhere.

    touch: None or (complex centre, radius, factor), off the rim. Galerkin with
    u = a_0 + sum a_m cos mt + b_m sin mt, m up to `harmonics`. The touch's share of the rim's
    energy is read off the Moebius image where it is concentric: there each harmonic costs
    2 pi m q / (1 - q) more, and q falls so fast that a few harmonics are all of it.
    Error ~ harmonics^-2 as in `complete_series`.
    """
    angles = np.asarray(angles, dtype=float)
    widths = np.broadcast_to(np.asarray(widths, dtype=float), angles.shape)
    z = np.broadcast_to(np.asarray(z, dtype=float), angles.shape)

    k = np.arange(2 * harmonics + 1)
    arc = widths[:, None] * np.sinc(0.5 * k * widths[:, None] / np.pi) / z[:, None]
    by_cosine, by_sine = arc * np.cos(angles[:, None] * k), arc * np.sin(angles[:, None] * k)
    cosine, sine = by_cosine.sum(axis=0), by_sine.sum(axis=0)
    m = np.arange(harmonics + 1)
    minus, plus = abs(m[:, None] - m[None, :]), m[:, None] + m[None, :]
    odd = np.sign(m[None, :] - m[:, None]) * sine[minus]
    matrix = 0.5 * np.block(
        [
            [cosine[minus] + cosine[plus], sine[plus] + odd],
            [(sine[plus] + odd).T, cosine[minus] - cosine[plus]],
        ]
    )
    matrix[np.diag_indices_from(matrix)] += np.tile(np.pi * m, 2)
    if touch is not None:
        projection, cost = _touch_energy(*touch, harmonics)
        matrix += projection.T @ (cost[:, None] * projection)
    kept = np.delete(np.arange(2 * harmonics + 2), harmonics + 1)
    matrix = matrix[np.ix_(kept, kept)]
    load = np.hstack([by_cosine[:, : harmonics + 1], by_sine[:, : harmonics + 1]])[:, kept]
    admittance = np.diag(arc[:, 0]) - load @ np.linalg.solve(matrix, load.T)
    centred = np.eye(len(angles)) - 1.0 / len(angles)
    return centred @ np.linalg.inv(admittance + 1.0 / len(angles)) @ centred


def _touch_energy(centre, radius, factor, harmonics):
    """Rim functions (2 K, 2 harmonics + 2) of the mapped disc, and what each costs more (2 K,)."""
    alpha, mapped = disc_map(complex(centre), radius)
    order = np.arange(1, int(np.ceil(-20.0 / np.log(mapped))) + 2)
    q = (factor - 1.0) / (factor + 1.0) * mapped ** (2.0 * order)
    grid = np.exp(2j * np.pi * np.arange(16 * harmonics) / (16 * harmonics))
    turned = (grid - alpha) / (1.0 - np.conj(alpha) * grid)
    pulled = (1.0 - abs(alpha) ** 2) / abs(1.0 - np.conj(alpha) * grid) ** 2
    images = turned ** order[:, None] * pulled
    spectra = [np.fft.fft(part, axis=1)[:, : harmonics + 1] for part in (images.real, images.imag)]
    rows = [np.hstack([s.real, -s.imag]) * (2.0 / len(grid)) for s in spectra]
    return np.vstack(rows), np.tile(2.0 * np.pi * order * q / (1.0 - q), 2)


def complete_touched(angles, widths, z, touch=None, harmonics=400):
    """As `complete_general`, extrapolated over 1, 2 and 4 times `harmonics`; value and error."""
    return extrapolated(
        *(complete_general(angles, widths, z, touch, k * harmonics) for k in (1, 2, 4))
    )
