/* Fills triangles with colours of values at their corners, in the nearest depth: without a graphics card, and the same
   on every machine. */
"use strict";

const SHADES = 32;  // of light
const BANDS = 8;    // between lines of equal value

class Raster {
    constructor(colours) {
        this.canvas = document.createElement("canvas");
        this.context = this.canvas.getContext("2d");
        this.table = new Uint32Array(SHADES * 256);  // colours by shade and value, alpha first
        for (let shade = 0; shade < SHADES; shade++) {
            const light = shade / (SHADES - 1);
            for (let k = 0; k < 256; k++) {
                const [r, g, b] = [0, 1, 2].map(c => Math.round(colours[3 * k + c] * light));
                this.table[shade * 256 + k] = (255 << 24 | b << 16 | g << 8 | r) >>> 0;
            }
        }
    }

    resize(width, height) {
        if (this.canvas.width === width && this.canvas.height === height) return;
        Object.assign(this.canvas, { width, height });
        this.image = this.context.createImageData(width, height);
        this.pixels = new Uint32Array(this.image.data.buffer);
        this.depth = new Float32Array(width * height);
        this.band = new Uint8Array(width * height);
    }

    /* Triangles by three corners each, at x, y [pixels] and depth z (larger is nearer), of values from 0 to 1, in a
       light from 0 to 1; nan is grey. */
    fill(triangles, x, y, z, values, light, lines) {
        this.pixels.fill(0);
        this.depth.fill(-Infinity);
        this.band.fill(0);
        for (let k = 0; k < triangles.length; k += 3)
            this.triangle(triangles[k], triangles[k + 1], triangles[k + 2], x, y, z, values, light);
        if (lines) this.lines();
        this.context.putImageData(this.image, 0, 0);
    }

    triangle(a, b, c, x, y, z, values, light) {
        let area = (x[b] - x[a]) * (y[c] - y[a]) - (x[c] - x[a]) * (y[b] - y[a]);
        if (!area) return;
        if (area < 0) { [b, c] = [c, b]; area = -area; }
        const { width, height } = this.canvas, { pixels, depth, band, table } = this;
        const left = Math.max(0, Math.ceil(Math.min(x[a], x[b], x[c]) - 0.5));
        const right = Math.min(width - 1, Math.floor(Math.max(x[a], x[b], x[c]) - 0.5));
        const top = Math.max(0, Math.ceil(Math.min(y[a], y[b], y[c]) - 0.5));
        const bottom = Math.min(height - 1, Math.floor(Math.max(y[a], y[b], y[c]) - 0.5));
        const slope = (p, q) => [(y[p] - y[q]) / area, (x[q] - x[p]) / area];  // of the share of the opposite corner
        const [ax, ay] = slope(b, c), [bx, by] = slope(c, a), grey = 0xffb0b0b0;
        for (let row = top; row <= bottom; row++) {
            let u = ax * (left + 0.5 - x[b]) + ay * (row + 0.5 - y[b]);
            let v = bx * (left + 0.5 - x[c]) + by * (row + 0.5 - y[c]);
            for (let column = left, at = row * width + left; column <= right; column++, at++, u += ax, v += bx) {
                const w = 1 - u - v;
                if (u < -1e-6 || v < -1e-6 || w < -1e-6) continue;
                const near = u * z[a] + v * z[b] + w * z[c];
                if (near < depth[at]) continue;
                depth[at] = near;
                const value = Math.min(1, Math.max(0, u * values[a] + v * values[b] + w * values[c]));
                const shade = light ? Math.round((SHADES - 1) * (u * light[a] + v * light[b] + w * light[c])) : SHADES - 1;
                pixels[at] = value === value ? table[shade * 256 + Math.round(255 * value)] : grey;
                band[at] = 1 + Math.min(BANDS - 1, Math.floor(BANDS * value));
            }
        }
    }

    /* Dark pixels where values of two bands meet. */
    lines() {
        const { width } = this.canvas, { band, pixels } = this;
        for (let at = 0; at + width < band.length; at++) {
            const one = band[at];
            if (one && (band[at + 1] && band[at + 1] !== one || band[at + width] && band[at + width] !== one))
                pixels[at] = 0xff202020;
        }
    }
}
