// Which column is which channel, by its name: guess(channels, columns, others) -> Map("y.flow" -> column).
//
// A column is a channel's if it has its name, or begins with it ("flow_1e8m3" for flow); then columns
// called y... and u... are outputs and inputs in their order; then, if just as many columns are left as
// channels, they are those, in their order. A file with other columns, which cannot be used, leaves that
// last step to the user: the one that is missing may be among them.

export function guess(channels, columns, others) {
  const found = new Map();
  const left = new Set(columns);
  const open = (member) => channels.filter((c) => (!member || c.member === member) && !found.has(key(c)));
  const take = (channel, column) => {
    if (column === undefined) return;
    found.set(key(channel), column);
    left.delete(column);
  };
  const same = (name) => (column) => column.toLowerCase() === name.toLowerCase();
  const begins = (name) => (column) => column.toLowerCase().startsWith(name.toLowerCase()) && !/[a-z0-9]/i.test(column[name.length] ?? "");
  for (const test of [same, begins]) {
    for (const channel of open()) take(channel, [...left].find(test(channel.name)));
  }
  for (const member of ["y", "u"]) {
    const called = [...left].filter((column) => new RegExp(`^${member}(?![a-z])`, "i").test(column));
    open(member).forEach((channel, i) => take(channel, called[i]));
  }
  const rest = [...left];
  if (!others && open().length === rest.length) open().forEach((channel, i) => take(channel, rest[i]));
  return found;
}

function key({ member, name }) {
  return `${member}.${name}`;
}
