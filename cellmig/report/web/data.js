/* Reads the arrays that encode.py wrote into a page. */
"use strict";

/* The bytes of text in base64 of zlib's format. */
async function inflated(text) {
    const letters = atob(text), bytes = new Uint8Array(letters.length);
    for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

/* An array as it was: a typed array, row by row. */
async function unpacked(packed) {
    const kinds = { f4: Float32Array, i4: Int32Array, u4: Uint32Array, u2: Uint16Array, u1: Uint8Array };
    const bytes = await inflated(packed.bytes);
    return new kinds[packed.type](bytes.buffer);
}

/* Rounded values as one Float32Array for each frame, nan where there is none; those with a scale are of asinh. */
async function unrounded(rounded) {
    const whole = number => rounded.step * (rounded.low + number);
    const value = "scale" in rounded ? number => rounded.centre + rounded.scale * Math.sinh(whole(number)) : whole;
    const bytes = await inflated(rounded.bytes), count = bytes.length / 2, frames = rounded.shape[0];
    const each = frames ? count / frames : 0, numbers = new Int32Array(each), found = [];
    for (let frame = 0, at = 0; frame < frames; frame++) {
        const values = new Float32Array(each);
        for (let i = 0; i < each; i++, at++) {
            const zigzag = bytes[at] | (bytes[at + count] << 8);
            numbers[i] += (zigzag >>> 1) ^ -(zigzag & 1);
            values[i] = numbers[i] === rounded.missing ? NaN : value(numbers[i]);
        }
        found.push(values);
    }
    return found;
}

/* A number with few digits, such as 1.235, 12,350 or 1.2e-6. */
function shown(value, digits = 4) {
    if (!Number.isFinite(value)) return "–";
    const size = Math.abs(value);
    if (size && (size < 1e-3 || size >= 1e6)) return value.toExponential(Math.max(0, digits - 2));
    return Number(value.toPrecision(digits)).toLocaleString("en", { maximumFractionDigits: 12 });
}

/* Round numbers from low to high, about `count` of them. */
function ticks(low, high, count) {
    const raw = (high - low) / Math.max(1, count), power = 10 ** Math.floor(Math.log10(raw));
    const step = [1, 2, 5, 10].find(k => k * power >= raw) * power, found = [];
    if (!(step > 0) || !Number.isFinite(step)) return [low];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
    return found;
}
