// Which column is which channel: match(channels, columns, counting) -> Map("y.flow" -> column).
//
// The rules are those of service/columns.py, where they are told; a test compares the two. ``columns``
// are those that can be used, ``counting`` those of them that only count, as years do.

const CLOCK = "ns|us|µs|ms|h|s|secs?|seconds?|mins?|minutes?|hrs?|hours?|d|days?|weeks?|months?|years?";
const TIME = new RegExp(`^((t|time)(s|[ _]*([[(]\\s*(${CLOCK})\\s*[\\])]|/\\s*(${CLOCK})))?|time[ _]+(${CLOCK})|t[ _]+([nuµm]?s|sec|seconds?))$`, "i");
const MAYBE_TEMPERATURE = /^T([sS]|[ _]+[\p{L}\p{N}_]+)?$/u;
const BY_NAME = [
  (column, { name }) => column === name,
  (column, { name }) => column.toLowerCase() === name.toLowerCase(),
  (column, { name, member }) => column.toLowerCase() === `${member}_${name}`.toLowerCase(),
  (column, { name }) => column.toLowerCase().startsWith(name.toLowerCase()) && !/^[\p{L}\p{N}]/u.test(column.slice(name.length)),
];

// Whether a column is called as times are.
export function isTime(column) {
  return TIME.test(column) && !MAYBE_TEMPERATURE.test(column);
}

export function match(channels, columns, counting) {
  const found = new Map();
  let left = columns.filter((column) => !isTime(column) || channels.some(({ name }) => name === column));
  const open = (member) => channels.filter((one) => (!member || one.member === member) && !found.has(key(one)));
  const take = (channel, column) => {
    found.set(key(channel), column);
    left = left.filter((one) => one !== column);
  };
  for (const test of BY_NAME) {
    for (const channel of open()) {
      const named = left.filter((column) => test(column, channel));
      if (named.length === 1) take(channel, named[0]);
    }
  }
  for (const member of ["y", "u"]) {
    const called = left.filter((column) => new RegExp(`^${member}(?!\\p{L})`, "iu").test(column));
    if (called.length === open(member).length) open(member).forEach((channel, i) => take(channel, called[i]));
  }
  const numbers = left.filter((column) => !counting.has(column));
  if (open().length === 1 && open("y").length === 1 && numbers.length === 1) take(open()[0], numbers[0]);
  return found;
}

function key({ member, name }) {
  return `${member}.${name}`;
}
