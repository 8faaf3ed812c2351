// The map of a field on a canvas. It moves under a drag once it is magnified: by +, - and 0, by the wheel with Ctrl, and by two fingers.
// Arrow keys go from cell to cell. While `onMark` is set, a drag marks a rectangle of cells, and Enter or the space bar marks a cell.
const MAX_ZOOM = 40;

// Pixels around a field, for its axes, and of the largest mark.
const AROUND = { left: 44, right: 10, top: 8, bottom: 38 };
const ABOVE = 60;
const MAX_MARK = 24;

// Outlines of marks around (0, 0), of size 2.
const SYMBOLS = {
  'triangle-up': [[0, -1], [0.9, 0.7], [-0.9, 0.7]],
  square: [[-1, -1], [1, -1], [1, 1], [-1, 1]],
  diamond: [[0, -1.2], [1.2, 0], [0, 1.2], [-1.2, 0]],
  pentagon: [0, 1, 2, 3, 4].map((each) => [Math.sin(0.4 * Math.PI * each), -Math.cos(0.4 * Math.PI * each)]),
  x: [[-1, -0.6], [-0.6, -1], [0, -0.4], [0.6, -1], [1, -0.6], [0.4, 0], [1, 0.6], [0.6, 1], [0, 0.4], [-0.6, 1], [-1, 0.6], [-0.4, 0]],
};
const DASHES = { dot: [2, 3], dash: [9, 5], dashdot: [9, 4, 2, 4], solid: [] };

// The colour of each of 256 levels, as red, green and blue; a scale has stops [level, '#rrggbb'].
function levels(scale) {
  const parts = scale.map(([at, text]) => [at, [1, 3, 5].map((begin) => parseInt(text.slice(begin, begin + 2), 16))]);
  return Array.from({ length: 256 }, (_, level) => {
    const at = level / 255;
    const next = Math.max(1, parts.findIndex(([end]) => end >= at));
    const [[low, one], [high, other]] = [parts[next - 1], parts[next]];
    const share = high > low ? (at - low) / (high - low) : 0;
    return one.map((value, place) => Math.round(value + share * (other[place] - value)));
  });
}

// A round step of at most so many ticks.
function tickStep(length, most) {
  const power = 10 ** Math.floor(Math.log10(length / most));
  return power * [1, 2, 5, 10].find((each) => each * power * most >= length);
}

class FieldMap {
  // `onCell` is called with a chosen cell, `tell` returns the text of a cell. Small maps are not magnified.
  constructor(box, onCell, tell, isSmall = false) {
    Object.assign(this, { box, onCell, tell, zoom: 1, middle: [0.5, 0.5], pointers: new Map(), isSmall });
    this.canvas = element('canvas', [], { tabIndex: isSmall ? -1 : 0 });
    this.canvas.setAttribute('aria-hidden', isSmall);
    this.tip = element('p', [], { className: 'tip', hidden: true });
    this.cells = document.createElement('canvas');
    box.replaceChildren(this.canvas, this.tip);
    const on = (name, act) => this.canvas.addEventListener(name, act.bind(this));
    on('pointerdown', this.press);
    on('pointermove', this.move);
    on('pointerup', this.release);
    on('pointercancel', this.release);
    on('pointerleave', () => { this.tip.hidden = true; });
    if (!isSmall) {
      on('keydown', this.key);
      this.canvas.addEventListener('wheel', (event) => {
        if (!event.ctrlKey) return;
        event.preventDefault();
        this.magnify(Math.exp(-event.deltaY / 300), [event.offsetX, event.offsetY]);
      }, { passive: false });
    }
    new ResizeObserver(() => this.render()).observe(box);
  }

  // Draw cells and traces. `data`: the cells first, {z, zmax, colorscale, opacity, ticks, title}, then lines and marks in metres.
  // `layout`: {grid, labels, arrows, image, unvisited, obstacles, marked, frame}.
  draw(data, layout) {
    Object.assign(this.box, { data, layout });
    const [{ z, zmax, colorscale }] = data;
    const { width, height } = layout.grid;
    const colour = levels(colorscale);
    const gray = [1, 3, 5].map((begin) => parseInt(colours().obstacle.slice(begin, begin + 2), 16));
    Object.assign(this.cells, { width, height });
    const context = this.cells.getContext('2d');
    const image = context.createImageData(width, height);
    z.forEach((row, up) => row.forEach((value, column) => {
      const each = up * width + column;
      const shade = layout.obstacles.has(each) ? gray : value === null ? null : colour[Math.round(255 * Math.min(1, value / zmax))];
      if (shade) image.data.set([...shade, 255], 4 * ((height - 1 - up) * width + column));
    }));
    context.putImageData(image, 0, 0);
    if (layout.image && this.picture?.src !== layout.image.source) {
      this.picture = new Image();
      this.picture.onload = () => this.render();
      this.picture.src = layout.image.source;
    }
    this.render();
  }

  // Frame a cell; the next key may come before it is drawn.
  choose(cell) {
    this.box.layout.frame = cell;
    this.renderSoon();
  }

  // Where the field lies on a canvas of this size: `scale` in pixels a metre, and the pixel of its corner.
  place(wide, high) {
    const { grid, arrows } = this.box.layout;
    const isBelow = wide < 500 && !this.isSmall;
    const bar = this.isSmall || !isBelow ? 56 : 0;
    const top = arrows.length ? ABOVE : AROUND.top;
    const inside = [wide - AROUND.left - AROUND.right - bar, high - top - AROUND.bottom - (isBelow ? 50 : 0)];
    const size = [grid.width, grid.height].map((each) => each * grid.resolution);
    const fitted = Math.min(...inside.map((each, axis) => each / size[axis]));
    const scale = fitted * this.zoom;
    const shown = inside.map((each, axis) => Math.min(each, size[axis] * scale));
    // The middle of the view, as a share of the field, stays within it.
    const half = shown.map((each, axis) => each / (2 * size[axis] * scale));
    this.middle = this.middle.map((each, axis) => Math.min(1 - half[axis], Math.max(half[axis], each)));
    const left = AROUND.left + Math.max(0, (inside[0] - shown[0]) / 2);
    const corner = [left - (this.middle[0] - half[0]) * size[0] * scale, top + shown[1] + (this.middle[1] - half[1]) * size[1] * scale];
    return { scale, left, top, shown, corner, isBelow, side: Math.min(MAX_MARK, scale * grid.resolution) };
  }

  render(wide = this.box.clientWidth, high = this.box.clientHeight, density = window.devicePixelRatio || 1) {
    if (!this.box.layout || !wide || !high) return;
    Object.assign(this.canvas, { width: Math.round(wide * density), height: Math.round(high * density) });
    this.canvas.style.touchAction = this.zoom > 1 || this.onMark ? 'none' : 'pan-x pan-y';
    const context = this.canvas.getContext('2d');
    const at = this.place(wide, high);
    context.setTransform(density, 0, 0, density, 0, 0);
    context.fillStyle = colours().paper;
    context.fillRect(0, 0, wide, high);
    context.save();
    context.beginPath();
    context.rect(at.left, at.top, ...at.shown);
    context.clip();
    this.paintCells(context, at);
    this.paintMarked(context, at);
    this.box.data.slice(1).filter(({ x }) => x.length).forEach((each) => (each.mode === 'lines' ? this.paintLines(context, at, each) : this.paintMarks(context, at, each)));
    this.paintFrame(context, at);
    context.restore();
    this.paintAxes(context, at);
    this.paintBar(context, at, wide);
    this.paintArrows(context, at);
  }

  at(at, x, y) {
    const { grid } = this.box.layout;
    return [at.corner[0] + (x - grid.x) * at.scale, at.corner[1] - (y - grid.y) * at.scale];
  }

  // Rows of cells that satisfy a condition, as rectangles of the cells in view.
  rectangles(at, isMeant) {
    const { width, height, resolution } = this.box.layout.grid;
    const side = at.scale * resolution;
    const range = (begin, end, most) => [Math.max(0, Math.floor(begin)), Math.min(most, Math.ceil(end))];
    const [first, last] = range((at.left - at.corner[0]) / side, (at.left + at.shown[0] - at.corner[0]) / side, width);
    const [low, high] = range((at.corner[1] - at.top - at.shown[1]) / side, (at.corner[1] - at.top) / side, height);
    const found = [];
    for (let row = low; row < high; row += 1) {
      for (let column = first; column < last; column += 1) {
        const begin = column;
        while (column < last && isMeant(row * width + column)) column += 1;
        if (column > begin) found.push([at.corner[0] + begin * side, at.corner[1] - (row + 1) * side, (column - begin) * side, side]);
      }
    }
    return found;
  }

  paintCells(context, at) {
    const { grid, image, unvisited } = this.box.layout;
    const size = [grid.width * grid.resolution * at.scale, grid.height * grid.resolution * at.scale];
    const [x, y] = [at.corner[0], at.corner[1] - size[1]];
    if (image && this.picture?.complete && this.picture.naturalWidth) {
      const [wide, high] = [image.width * at.scale, image.height * at.scale];
      context.drawImage(this.picture, x, at.corner[1] - high, wide, high);
    }
    context.imageSmoothingEnabled = false;
    context.globalAlpha = this.box.data[0].opacity;
    context.drawImage(this.cells, x, y, ...size);
    context.globalAlpha = 1;
    const found = unvisited.size ? this.rectangles(at, (each) => unvisited.has(each)) : [];
    if (!found.length) return;
    context.save();
    context.beginPath();
    found.forEach((each) => context.rect(...each));
    context.clip();
    context.beginPath();
    const [left, top, right, bottom] = [at.left, at.top, at.left + at.shown[0], at.top + at.shown[1]];
    const gap = Math.max(10, Math.min(18, 0.7 * at.scale * grid.resolution));
    for (let begin = left; begin < right + bottom - top; begin += gap) {
      context.moveTo(begin, top);
      context.lineTo(begin - (bottom - top), bottom);
    }
    // Dark lines within light lines are visible on light and dark maps; on a picture of the site they are faint.
    for (const [style, wide] of [[`rgba(255, 255, 255, ${image ? 0.2 : 0.5})`, 2.5], [image ? 'rgba(80, 80, 80, 0.4)' : '#505050', 1]]) {
      context.strokeStyle = style;
      context.lineWidth = wide;
      context.stroke();
    }
    context.restore();
  }

  // Marked cells, and the rectangle of a drag.
  paintMarked(context, at) {
    const { marked } = this.box.layout;
    const dragged = new Set(this.dragged);
    if (!marked.size && !dragged.size) return;
    context.beginPath();
    this.rectangles(at, (each) => marked.has(each) || dragged.has(each)).forEach((each) => context.rect(...each));
    Object.assign(context, { fillStyle: 'rgba(0, 158, 255, 0.45)', strokeStyle: '#003a66', lineWidth: 1.5 });
    context.fill();
    context.stroke();
  }

  // The cells of the rectangle between two cells.
  rectangle(...corners) {
    const { width } = this.box.layout.grid;
    const [columns, rows] = [corners.map((each) => each % width), corners.map((each) => Math.floor(each / width))];
    const range = (ends) => Array.from({ length: Math.abs(ends[1] - ends[0]) + 1 }, (_, place) => Math.min(...ends) + place);
    return range(rows).flatMap((row) => range(columns).map((column) => row * width + column));
  }

  paintLines(context, at, { x, y, line, opacity = 1 }) {
    context.beginPath();
    let isOn = false;
    x.forEach((each, place) => {
      if (each !== null) context[isOn ? 'lineTo' : 'moveTo'](...this.at(at, each, y[place]));
      isOn = each !== null;
    });
    context.setLineDash(DASHES[line.dash ?? 'solid']);
    Object.assign(context, { strokeStyle: line.color, lineWidth: line.width, lineJoin: 'round', globalAlpha: opacity });
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  // Marks have a size in pixels, or a `share` of the side of a cell, of at least `least` pixels.
  paintMarks(context, at, { x, y, marker }) {
    const isOpen = marker.symbol?.endsWith('-open');
    const outline = SYMBOLS[marker.symbol?.replace('-open', '')];
    context.beginPath();
    x.forEach((each, place) => {
      if (each === null) return;
      const [right, down] = this.at(at, each, y[place]);
      const share = Array.isArray(marker.share) ? marker.share[place] : marker.share;
      const half = (marker.size ?? Math.max(marker.least ?? 0, share * at.side)) / 2;
      const isSeen = right > at.left - half && right < at.left + at.shown[0] + half && down > at.top - half && down < at.top + at.shown[1] + half;
      // Below a pixel nothing is seen, and fields of many cells have many marks.
      if (!isSeen || half < 0.5) return;
      if (outline) {
        outline.forEach(([along, across], corner) => context[corner ? 'lineTo' : 'moveTo'](right + half * along, down + half * across));
        context.closePath();
      } else {
        context.moveTo(right + half, down);
        context.arc(right, down, half, 0, 2 * Math.PI);
      }
    });
    Object.assign(context, { fillStyle: marker.color, globalAlpha: marker.opacity ?? 1 });
    if (!isOpen) context.fill();
    const { color, width } = marker.line ?? {};
    if (color || isOpen) {
      Object.assign(context, { strokeStyle: color ?? marker.color, lineWidth: width ?? 1.5 });
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  // A frame around the chosen cell: black within white, for light and dark maps.
  paintFrame(context, at) {
    const { frame, grid } = this.box.layout;
    if (frame === null) return;
    const side = Math.max(6, at.scale * grid.resolution);
    const [x, y] = this.at(at, ...this.center(frame));
    for (const [style, wide] of [['#ffffff', 5], ['#000000', 2]]) {
      Object.assign(context, { strokeStyle: style, lineWidth: wide });
      context.strokeRect(x - side / 2, y - side / 2, side, side);
    }
  }

  center(each) {
    const { x, y, width, resolution } = this.box.layout.grid;
    return [x + ((each % width) + 0.5) * resolution, y + (Math.floor(each / width) + 0.5) * resolution];
  }

  paintAxes(context, at) {
    const { grid, labels } = this.box.layout;
    const { text, line } = colours();
    Object.assign(context, { strokeStyle: line, fillStyle: text, lineWidth: 1, font: '12px system-ui, sans-serif' });
    context.strokeRect(at.left, at.top, ...at.shown);
    const bottom = at.top + at.shown[1];
    [0, 1].forEach((axis) => {
      const origin = axis ? grid.y : grid.x;
      const [low, high] = axis ? [(at.corner[1] - bottom) / at.scale, (at.corner[1] - at.top) / at.scale]
        : [(at.left - at.corner[0]) / at.scale, (at.left + at.shown[0] - at.corner[0]) / at.scale];
      const step = tickStep(high - low, Math.max(2, at.shown[axis] / 70));
      context.textAlign = axis ? 'right' : 'center';
      context.textBaseline = axis ? 'middle' : 'top';
      for (let number = Math.ceil((origin + low) / step - 1e-9); number * step <= origin + high + 1e-9 * step; number += 1) {
        const [x, y] = this.at(at, axis ? grid.x : number * step, axis ? number * step : grid.y);
        const label = String(Number((number * step).toPrecision(6)));
        if (axis) context.fillText(label, at.left - 5, y);
        else context.fillText(label, x, bottom + 4);
      }
    });
    context.textAlign = 'center';
    context.textBaseline = 'alphabetic';
    context.fillText(labels[0], at.left + at.shown[0] / 2, bottom + 31);
    context.save();
    context.translate(at.left - 33, at.top + at.shown[1] / 2);
    context.rotate(-Math.PI / 2);
    context.fillText(labels[1], 0, 0);
    context.restore();
  }

  // The scale of the colours: beside the field, and on a narrow screen below it.
  paintBar(context, at, wide) {
    const { colorscale, ticks, zmax, title } = this.box.data[0];
    const length = at.isBelow ? at.shown[0] : 0.9 * at.shown[1];
    const [x, y] = at.isBelow ? [at.left, at.top + at.shown[1] + 42] : [at.left + at.shown[0] + 12, at.top + 0.05 * at.shown[1]];
    const gradient = at.isBelow ? context.createLinearGradient(x, y, x + length, y) : context.createLinearGradient(x, y + length, x, y);
    colorscale.forEach(([stop, colour]) => gradient.addColorStop(stop, colour));
    context.fillStyle = gradient;
    context.fillRect(x, y, at.isBelow ? length : 10, at.isBelow ? 10 : length);
    Object.assign(context, { fillStyle: colours().text, textAlign: at.isBelow ? 'center' : 'left', textBaseline: at.isBelow ? 'top' : 'middle' });
    ticks.forEach((each) => {
      const label = String(Number(each.toFixed(2)));
      if (at.isBelow) context.fillText(label, x + (each / zmax) * length, y + 12);
      else context.fillText(label, x + 14, y + length - (each / zmax) * length);
    });
    if (this.isSmall) return;
    context.save();
    Object.assign(context, { textAlign: 'center', textBaseline: 'alphabetic' });
    if (at.isBelow) context.fillText(title, x + length / 2, y + 36);
    else {
      context.translate(Math.min(wide - 4, x + 46), y + length / 2);
      context.rotate(-Math.PI / 2);
      context.fillText(title, 0, 0);
    }
    context.restore();
  }

  // Arrows above the left edge, at angles in rad from the right, with labels at their heads.
  paintArrows(context, at) {
    const [x, y] = [at.left + 30, at.top - 30];
    Object.assign(context, { strokeStyle: '#808080', lineWidth: 1.5, textAlign: 'center', textBaseline: 'middle', fillStyle: colours().text });
    this.box.layout.arrows.forEach(([label, angle]) => {
      const [along, up] = [Math.cos(angle), -Math.sin(angle)];
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(x + 17 * along, y + 17 * up);
      for (const side of [-0.5, 0.5]) {
        context.moveTo(x + 17 * along, y + 17 * up);
        context.lineTo(x + 17 * along - 6 * Math.cos(angle + side), y + 17 * up + 6 * Math.sin(angle + side));
      }
      context.stroke();
      context.fillText(label, x + 25 * along, y + 25 * up);
    });
  }

  // Where a pixel of the view lies, as shares of the width and the height of the field.
  shareAt(x, y) {
    const { grid } = this.box.layout;
    const { corner, scale } = this.place(this.box.clientWidth, this.box.clientHeight);
    const side = scale * grid.resolution;
    return [(x - corner[0]) / (side * grid.width), (corner[1] - y) / (side * grid.height)];
  }

  // The cell at a pointer; null beside the field.
  cellAt({ offsetX, offsetY }) {
    const { width, height } = this.box.layout.grid;
    const { left, top, shown } = this.place(this.box.clientWidth, this.box.clientHeight);
    const isInside = offsetX >= left && offsetX < left + shown[0] && offsetY >= top && offsetY < top + shown[1];
    const [along, up] = this.shareAt(offsetX, offsetY);
    return isInside && along >= 0 && along < 1 && up >= 0 && up < 1 ? Math.floor(up * height) * width + Math.floor(along * width) : null;
  }

  // Move the view so that what was at one pixel is at another.
  shift(before, share) {
    this.middle = this.middle.map((each, axis) => each + share[axis] - before[axis]);
    this.renderSoon();
  }

  // Render with the next frame of the browser, once.
  renderSoon() {
    if (this.isDue) return;
    this.isDue = true;
    requestAnimationFrame(() => {
      this.isDue = false;
      this.render();
    });
  }

  // Magnify by a factor around a pixel, or around the middle of the view; 0 shows the whole field.
  magnify(factor, pixel) {
    const share = pixel ? this.shareAt(...pixel) : null;
    this.zoom = factor ? Math.min(MAX_ZOOM, Math.max(1, this.zoom * factor)) : 1;
    this.shift(...(pixel ? [this.shareAt(...pixel), share] : [[0, 0], [0, 0]]));
  }

  press(event) {
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    this.moved = 0;
    this.from = this.onMark && this.pointers.size === 1 ? this.cellAt(event) : null;
    this.dragged = [];
    if (!this.isSmall) this.canvas.setPointerCapture(event.pointerId);
  }

  move(event) {
    if (!this.box.layout) return;
    const before = this.pointers.get(event.pointerId);
    if (!before) {
      this.hover(event);
      return;
    }
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    const now = [event.offsetX, event.offsetY];
    this.pointers.set(event.pointerId, now);
    this.moved += Math.hypot(now[0] - before[0], now[1] - before[1]);
    if (this.isSmall) return;
    if (other) {
      const distance = ([x, y]) => Math.hypot(x - other[0], y - other[1]);
      this.magnify(distance(now) / Math.max(1, distance(before)), now);
    } else if (this.onMark) {
      const to = this.cellAt(event);
      if (this.from !== null && to !== null) this.dragged = this.rectangle(this.from, to);
      this.render();
    } else if (this.zoom > 1) this.shift(this.shareAt(...now), this.shareAt(...before));
  }

  hover(event) {
    const each = this.cellAt(event);
    this.tip.hidden = each === null || event.pointerType === 'touch';
    if (this.tip.hidden) return;
    this.tip.textContent = this.tell(each);
    const isRight = event.offsetX > this.box.clientWidth / 2;
    Object.assign(this.tip.style, {
      left: isRight ? 'auto' : `${event.offsetX + 14}px`, right: isRight ? `${this.box.clientWidth - event.offsetX + 14}px` : 'auto',
      top: `${event.offsetY + 10}px`,
    });
  }

  release(event) {
    const isClick = this.pointers.size === 1 && this.moved < 5 && event.type === 'pointerup';
    this.pointers.delete(event.pointerId);
    const each = isClick ? this.cellAt(event) : null;
    if (each !== null) this.onCell(each);
    const marked = each === null ? this.dragged : [each];
    this.dragged = [];
    if (this.onMark && marked.length && event.type === 'pointerup') this.onMark(marked);
  }

  key(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    const { grid, frame } = this.box.layout;
    if (this.onMark && frame !== null && ['Enter', ' '].includes(event.key)) {
      event.preventDefault();
      this.onMark([frame]);
      return;
    }
    const [across, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key] ?? [];
    const factor = { '+': 1.5, '-': 1 / 1.5, 0: 0 }[event.key];
    if (across === undefined && factor === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    if (factor !== undefined) {
      this.magnify(factor);
      return;
    }
    const from = frame ?? grid.bases[0];
    const [column, row] = [(from % grid.width) + across, Math.floor(from / grid.width) + up];
    if (column < 0 || column >= grid.width || row < 0 || row >= grid.height) return;
    this.onCell(row * grid.width + column);
    this.see(row * grid.width + column);
  }

  // Move the view to a cell that is outside of it.
  see(each) {
    const at = this.place(this.box.clientWidth, this.box.clientHeight);
    const [x, y] = this.at(at, ...this.center(each));
    const isSeen = x > at.left && x < at.left + at.shown[0] && y > at.top && y < at.top + at.shown[1];
    if (isSeen) return;
    const { width, height } = this.box.layout.grid;
    this.middle = [((each % width) + 0.5) / width, (Math.floor(each / width) + 0.5) / height];
    this.render();
  }

  // The map as a PNG, of three pixels a pixel.
  save(name) {
    this.render(this.box.clientWidth, this.box.clientHeight, 3);
    this.canvas.toBlob((blob) => keep(name, 'image/png', blob));
    this.render();
  }
}
