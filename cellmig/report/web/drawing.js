/* What player and gallery draw around filled triangles: light, outlines, the substrate, axes, arrows, colour bars. */
"use strict";

const LIGHT = [-0.35, 0.55, 0.75];  // direction to the light: to the right, up, to the eye
const dot = (a, b) => a.reduce((sum, value, k) => sum + value * (b[k] ?? 0), 0);

function least(values) {
    let found = Infinity;
    for (const value of values) if (value < found) found = value;
    return found;
}

/* Light from 0 to 1 on the corners of a surface at x (by axis), from the triangles around each. */
function shine(light, x, triangles, view) {
    const normals = x.map(axis => new Float32Array(axis.length));
    for (let k = 0; k < triangles.length; k += 3) {
        const [a, b, c] = triangles.subarray(k, k + 3), p = x.map(v => v[b] - v[a]), q = x.map(v => v[c] - v[a]);
        const n = [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
        for (const i of [a, b, c]) n.forEach((value, axis) => { normals[axis][i] += value; });
    }
    const axes = view.axes(), direction = [0, 1, 2].map(c => axes.reduce((sum, axis, k) => sum + LIGHT[k] * axis[c], 0));
    for (let i = 0; i < light.length; i++) {
        const n = normals.map(axis => axis[i]), size = Math.hypot(...n) || 1, facing = dot(n, axes[2]) < 0 ? -1 : 1;
        light[i] = 0.6 + 0.4 * Math.min(1, Math.max(0, facing * dot(n, direction) / size));
    }
}

/* Outlines of cells, dark, and where materials meet, white; `on` : places of the particles [pixels]. */
function drawOutlines(g, on, loops, borders, ratio) {
    const { x, y } = on, middle = (p, q) => [(x[p] + x[q]) / 2, (y[p] + y[q]) / 2];
    g.lineWidth = ratio;
    g.strokeStyle = "#fff";
    g.beginPath();
    for (let k = 0; k < borders.length; k += 3) {
        g.moveTo(...middle(borders[k], borders[k + 1]));
        g.lineTo(...middle(borders[k], borders[k + 2]));
    }
    g.stroke();
    g.strokeStyle = "#111";
    g.beginPath();
    for (const loop of loops) loop.forEach((i, k) => (k ? g.lineTo(x[i], y[i]) : g.moveTo(x[i], y[i])));
    g.stroke();
}

function drawArrow(g, ax, ay, bx, by) {
    const size = Math.hypot(bx - ax, by - ay), head = Math.min(6, 0.5 * size), turn = Math.PI * 0.85;
    const angle = [bx - ax, by - ay].map(one => one / (size || 1));
    const side = sign => [bx + head * (angle[0] * Math.cos(turn) - sign * angle[1] * Math.sin(turn)),
                          by + head * (sign * angle[0] * Math.sin(turn) + angle[1] * Math.cos(turn))];
    g.beginPath();
    g.moveTo(ax, ay);
    g.lineTo(bx, by);
    g.moveTo(...side(1));
    g.lineTo(bx, by);
    g.lineTo(...side(-1));
    g.stroke();
}

/* The substrate: a line with hatches, or a grid in three dimensions. */
function drawGround(g, view, substrate) {
    g.lineWidth = 1;
    if (view.dimension === 2) {
        if (!substrate) return;
        const [left, y] = view.at([view.low[0], 0]);
        g.strokeStyle = "#555";
        g.beginPath();
        g.moveTo(0, y);
        g.lineTo(view.width, y);
        for (let x = left % 9; x < view.width + 6; x += 9) { g.moveTo(x, y); g.lineTo(x - 5, y + 5); }
        g.stroke();
        return;
    }
    const { low, high } = view, z = substrate ? 0 : low[2], step = ticks(low[0], high[0], 6);
    const apart = step[1] - step[0] || 1, [x0, y0] = [0, 1].map(c => Math.floor(low[c] / apart) * apart);
    const [x1, y1] = [0, 1].map(c => Math.ceil(high[c] / apart) * apart);
    const line = (a, b) => { g.moveTo(...view.at(a)); g.lineTo(...view.at(b)); };
    g.fillStyle = view.elevation < 0 ? "#fff" : "#f1f1f1";
    g.beginPath();
    [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].forEach((p, k) => (k ? g.lineTo : g.moveTo).apply(g, view.at([...p, z])));
    g.fill();
    g.strokeStyle = "#c8c8c8";
    g.beginPath();
    for (let x = x0; x <= x1 + 1e-9; x += apart) line([x, y0, z], [x, y1, z]);
    for (let y = y0; y <= y1 + 1e-9; y += apart) line([x0, y, z], [x1, y, z]);
    g.stroke();
}

/* Ticks along the axes in two dimensions; directions and a scale in three. */
function drawAxes(g, view) {
    g.font = "11px system-ui, sans-serif";
    g.fillStyle = g.strokeStyle = "#333";
    g.lineWidth = 1;
    if (view.dimension === 3) { drawScale(g, view); return; }
    const [x0, y1] = view.place(EDGE.left, EDGE.top), [x1, y0] = view.place(view.width - EDGE.right, view.height - EDGE.bottom);
    g.fillStyle = "#ffffffd0";
    g.fillRect(0, view.height - EDGE.bottom, view.width, EDGE.bottom);
    g.fillRect(0, 0, EDGE.left, view.height);
    g.fillStyle = "#333";
    g.textAlign = "center";
    for (const x of ticks(x0, x1, view.width / 90)) {
        const [at] = view.at([x, 0]);
        g.fillRect(at, view.height - EDGE.bottom, 1, 4);
        g.fillText(shown(x), at, view.height - EDGE.bottom + 15);
    }
    g.textAlign = "right";
    for (const y of ticks(y0, y1, view.height / 45)) {
        const [, at] = view.at([0, y]);
        if (at < 24) continue;  // there stands the name of the axis
        g.fillRect(EDGE.left - 4, at, 4, 1);
        g.fillText(shown(y), EDGE.left - 7, at + 4);
    }
    g.fillText("x [µm]", view.width - EDGE.right, view.height - 3);
    g.textAlign = "left";
    g.fillText("y [µm]", 4, 12);
}

function drawScale(g, view) {
    const origin = [34, view.height - 34];
    ["x", "y", "z"].forEach((name, k) => {
        const [right, up] = view.axes().map(axis => axis[k]), end = [origin[0] + 24 * right, origin[1] - 24 * up];
        drawArrow(g, ...origin, ...end);
        g.fillText(name, end[0] + 5 * Math.sign(right || 1), end[1] - 2);
    });
    const length = ticks(0, 160 / view.scale, 1.2)[1] || 1, left = view.width - 24 - length * view.scale;
    g.fillRect(left, view.height - 16, length * view.scale, 3);
    g.textAlign = "center";
    g.fillText(`${shown(length)} µm`, left + length * view.scale / 2, view.height - 22);
    g.textAlign = "left";
}

/* A colour bar with numbers, for values from low to high; beyond: whether there are values below and above. */
function drawBar(canvas, { low, high, beyond, label, colours }) {
    const g = canvas.getContext("2d"), ratio = Math.min(2, window.devicePixelRatio || 1), wide = canvas.clientWidth, left = 44;
    Object.assign(canvas, { width: wide * ratio, height: 52 * ratio });
    g.scale(ratio, ratio);
    const across = Math.min(wide - left - 20, 560);
    for (let k = 0; k < across; k++) {
        const c = 3 * Math.round(255 * k / across);
        g.fillStyle = `rgb(${colours[c]} ${colours[c + 1]} ${colours[c + 2]})`;
        g.fillRect(left + k, 6, 1.5, 12);
    }
    g.fillStyle = "#333";
    g.font = "11px system-ui, sans-serif";
    g.textAlign = "center";
    ticks(low, high, across / 90).forEach(value => {
        const x = left + across * (value - low) / (high - low);
        g.fillRect(x, 18, 1, 4);
        g.fillText(shown(value), x, 33);
    });
    if (beyond[0]) g.fillText("◀", left - 8, 16);
    if (beyond[1]) g.fillText("▶", left + across + 9, 16);
    g.textAlign = "left";
    g.fillText(label, 4, 48, wide - 8);
}
