/* How places of a scene become places of a picture: from the side in two dimensions, from any side in three. */
"use strict";

const EDGE = { left: 44, right: 12, top: 10, bottom: 30 };  // around a scene in two dimensions [CSS pixels]

class View {
    /* low, high: corners of the scene [µm]. */
    constructor(dimension, low, high) {
        Object.assign(this, { dimension, low, high, width: 1, height: 1 });
        this.home();
    }

    home() {
        Object.assign(this, { zoom: 1, moved: [0, 0], azimuth: -65 * Math.PI / 180, elevation: 22 * Math.PI / 180 });
        this.fit();
    }

    /* Scale and middle at which all of the scene is in the picture. */
    fit() {
        const { low, high, dimension, width, height } = this;
        this.middle = low.map((one, k) => (one + high[k]) / 2);
        let wide = high[0] - low[0], tall = high[1] - low[1];
        if (dimension === 3) {
            const corners = [...Array(8).keys()].map(k => this.turned([0, 1, 2].map(c => (k >> c & 1 ? high : low)[c])));
            [wide, tall] = [0, 1].map(c => 2.1 * Math.max(...corners.map(one => Math.abs(one[c]))));
        }
        const across = width - (dimension === 2 ? EDGE.left + EDGE.right : 40);
        const up = height - (dimension === 2 ? EDGE.top + EDGE.bottom : 30);
        this.fitted = Math.min(across / (wide || 1), up / (tall || 1));
    }

    /* Show another box; one of the same size leaves the scale as it is. */
    show([low, high]) {
        const same = low.every((one, k) => Math.abs(high[k] - one - this.high[k] + this.low[k]) < 1e-6 * (high[k] - one));
        Object.assign(this, { low, high });
        if (same) this.middle = low.map((one, k) => (one + high[k]) / 2); else this.fit();
    }

    resize(width, height) {
        if (width === this.width && height === this.height) return;
        Object.assign(this, { width, height });
        this.fit();
    }

    get scale() { return this.fitted * this.zoom; }

    get centre() {
        const flat = this.dimension === 2;
        return [(this.width + (flat ? EDGE.left - EDGE.right : 0)) / 2 + this.moved[0],
                (this.height + (flat ? EDGE.top - EDGE.bottom : 0)) / 2 + this.moved[1]];
    }

    /* The directions to the right, up, and to the eye. */
    axes() {
        if (this.dimension === 2) return [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
        const [ca, sa, ce, se] = [Math.cos(this.azimuth), Math.sin(this.azimuth), Math.cos(this.elevation),
                                  Math.sin(this.elevation)];
        return [[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]];
    }

    /* A place relative to the middle, along the axes [µm]. */
    turned(place) {
        return this.axes().map(axis => axis.reduce((sum, a, k) => sum + a * ((place[k] ?? 0) - (this.middle[k] ?? 0)), 0));
    }

    /* A place [µm] in the picture [CSS pixels]. */
    at(place) {
        const [x, y] = this.turned(place), [cx, cy] = this.centre;
        return [cx + this.scale * x, cy - this.scale * y];
    }

    /* The place [µm] of a point of the picture, in two dimensions. */
    place(x, y) {
        const [cx, cy] = this.centre;
        return [this.middle[0] + (x - cx) / this.scale, this.middle[1] - (y - cy) / this.scale];
    }

    /* Many places, by axis, in pixels of which `ratio` make a CSS pixel; depth is larger for what is nearer. */
    project(x, ratio, out) {
        const [right, up, eye] = this.axes(), [cx, cy] = this.centre, scale = this.scale * ratio, m = this.middle;
        const n = x[0].length, flat = this.dimension === 2;
        for (let i = 0; i < n; i++) {
            const px = x[0][i] - m[0], py = x[1][i] - m[1], pz = flat ? 0 : x[2][i] - m[2];
            out.x[i] = cx * ratio + scale * (right[0] * px + right[1] * py + right[2] * pz);
            out.y[i] = cy * ratio - scale * (up[0] * px + up[1] * py + up[2] * pz);
            out.z[i] = flat ? 0 : eye[0] * px + eye[1] * py + eye[2] * pz;
        }
    }

    /* Zoom about a point of the picture. */
    zoomAt(factor, x = this.centre[0], y = this.centre[1]) {
        const next = Math.min(60, Math.max(0.3, this.zoom * factor)), [cx, cy] = this.centre;
        const change = next / this.zoom;
        this.moved[0] += (x - cx) * (1 - change);
        this.moved[1] += (y - cy) * (1 - change);
        this.zoom = next;
    }

    move(dx, dy) { this.moved[0] += dx; this.moved[1] += dy; }

    turn(dx, dy) {
        this.azimuth -= dx * 0.008;
        this.elevation = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, this.elevation + dy * 0.008));
    }
}
